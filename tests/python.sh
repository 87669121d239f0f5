#!/usr/bin/env bash
# Builds the Python wheel, installs it into a fresh virtual environment, and runs its tests there, without cargo on the path. PyTorch is
# the system's (Debian's python3-torch, for the CPU); where there is none, its tests are skipped, which pytest says.
set -euo pipefail
cd "$(dirname "$0")/.."

python=python3
[ -x /usr/bin/python3 ] && python=/usr/bin/python3
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")/python
tools=$target/tools
[ -x "$tools/bin/maturin" ] || { "$python" -m venv "$tools" && "$tools/bin/pip" install --quiet 'maturin>=1.16,<2'; }
rm -rf "$target/wheels"
"$tools/bin/maturin" build --release --quiet --out "$target/wheels"
du -h "$target"/wheels/*.whl

rm -rf "$target/venv"
"$python" -m venv --system-site-packages "$target/venv"
"$target/venv/bin/pip" install --quiet -r python/tests/requirements.txt "$target"/wheels/*.whl
export PATH="$target/venv/bin:/usr/bin:/bin"
# From a folder without the sources, so that only the installed package can be imported.
python -m mypy --config-file pyproject.toml --cache-dir "$target/mypy" -p regolith_render
cd "$target"
python -m pytest -q -rs "$OLDPWD/python/tests"
