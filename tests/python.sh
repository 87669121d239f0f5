#!/usr/bin/env bash
# Builds the Python wheel, installs it into fresh virtual environments, and runs its tests there, without cargo on the path. PyTorch is
# the system's (Debian's python3-torch, for the CPU); where there is none, its tests are skipped, which pytest says. Ray (80 MB) and
# Rerun (170 MB), with pandas and pyarrow (70 MB), come from PyPI into an environment of their own: they bring a newer NumPy than
# that PyTorch was made for.
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
rm -rf "$target/venv-data"
"$python" -m venv "$target/venv-data"
"$target/venv-data/bin/pip" install --quiet -r python/tests/requirements-data.txt "$target"/wheels/*.whl
export PATH="$target/venv/bin:/usr/bin:/bin"
# From a folder without the sources, so that only the installed package can be imported.
python -m mypy --config-file pyproject.toml --cache-dir "$target/mypy" -p regolith_render
cd "$target"
python -c "import torch" 2>/dev/null \
    && python -m mypy --config-file "$OLDPWD/pyproject.toml" --cache-dir "$target/mypy" "$OLDPWD/python/examples/train_segmentation.py"
python -m pytest -q -rs "$OLDPWD/python/tests" --ignore "$OLDPWD/python/tests/test_ray.py" --deselect "$OLDPWD/python/tests/test_examples.py::test_rerun_gets_camera_images_and_mesh"
export PATH="$target/venv-data/bin:/usr/bin:/bin"
python -m mypy --config-file "$OLDPWD/pyproject.toml" --cache-dir "$target/mypy-data" "$OLDPWD/python/examples/view_in_rerun.py"
python -m pytest -q -rs "$OLDPWD/python/tests/test_ray.py" "$OLDPWD/python/tests/test_examples.py" "$OLDPWD/python/tests/test_docs.py" -k "ray or rerun"
