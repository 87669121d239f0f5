#!/usr/bin/env bash
# Compares exports, frames and datasets with other programs: sets up their virtual environment below target/, then runs
# check.py, or the script named by the first argument, with the arguments that follow.
# Uses the binary that `cargo build --release` built. PYTHON selects another interpreter than python3.11.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
target=${CARGO_TARGET_DIR:-$root/target}
binary=$target/release/regolith-render
script=${1:-check.py}
# Blender and the dataset readers need different versions of NumPy.
case $script in
    check_datasets.py | check_recipes.py) kind=datasets requirements=("$here"/requirements-{datasets,recipes}.txt) ;;
    *) kind=exports requirements=("$here/requirements.txt") ;;
esac
venv=$target/outside/venv-$kind
export PYTHONDONTWRITEBYTECODE=1 REGOLITH_BINARY=$binary REGOLITH_OUTSIDE=$target/outside

fail() { echo "tests/outside: $*" >&2; exit 1; }

[ -x "$binary" ] || fail "$binary is missing: cargo build --release"
newer=$(find "$root/src" "$root/shaders" "$root/assets/presets" -newer "$binary" -type f -print -quit)
[ -z "$newer" ] || fail "$binary is older than $newer: cargo build --release"

python=${PYTHON:-$(command -v python3.11 || command -v python3)} || fail "no python3"
stamp=$(cat "${requirements[@]}" "$here"/requirements-{blender,yolo}.txt; "$python" --version)
if [ "$(cat "$venv/stamp" 2>/dev/null)" != "$stamp" ]; then
    mkdir -p "$target/outside"
    "$python" -m venv --clear "$venv" || fail "no virtual environment (Debian, Ubuntu: apt-get install python3-venv)"
    install="$venv/bin/pip install --quiet --no-compile --disable-pip-version-check"
    for file in "${requirements[@]}"; do
        $install -r "$file" || fail "pip could not install $file"
    done
    # Its label check is read from its sources: what it depends on has some 5 GB.
    [ $kind != datasets ] || $install --no-deps -r "$here/requirements-yolo.txt" || fail "pip could not install Ultralytics"
    log=$target/outside/blender.log
    if [ $kind = exports ] && ! $install -r "$here/requirements-blender.txt" 2>"$log"; then
        cat "$log" >&2
        # A missing wheel for this Python or machine is tolerated; a missing network or a full disk is not.
        grep -q "No matching distribution found for bpy" "$log" && ! grep -q "Retrying (" "$log" \
            || fail "pip could not install Blender"
        platform="$("$python" --version) $(uname -sm)"
        [[ $platform != "Python 3.11."*" Linux x86_64" ]] || fail "there is a wheel of Blender for $platform"
        echo "$platform" >"$venv/no-blender"
    fi
    echo "$stamp" >"$venv/stamp"
fi

status=0
"$venv/bin/python" "$here/$script" "${@:2}" || status=$?
if [ -e "$venv/no-blender" ]; then
    echo "!!! BLENDER DID NOT RUN: PyPI has no $(grep ^bpy "$here/requirements-blender.txt") for" \
        "$(cat "$venv/no-blender"); masks and shadows were not compared with Cycles !!!" >&2
fi
exit $status
