#!/bin/sh
# Run some tests with the oldest version of each dependency that pyproject.toml allows, in an
# environment of its own (LOWEST, .venv-lowest): what is stated there is what was run. Needs uv.
set -eu
cd "$(dirname "$0")/.."
LOWEST=${LOWEST:-.venv-lowest}
command -v uv >/dev/null || { echo "make test-lowest needs uv: pip install uv" >&2; exit 2; }
"${PYTHON:-python3}" -m venv "$LOWEST"
uv pip install --quiet --python "$LOWEST/bin/python" --resolution lowest-direct -e '.[dev]'
uv pip list --python "$LOWEST/bin/python" | grep -iE '^(drjit|mitsuba|num|scipy|pandas|pyarrow|trimesh|mapbox|dracopy|matplotlib|jinja2|typer|rich|platformdirs|dask|distributed|pytest|hypothesis) '
PYTHON="$LOWEST/bin/python" sh tools/ensure_llvm.sh
# Of each dependency, what uses it: arrays and kernels, meshes, figures, tables, the command line.
# Old packages warn of what their newer dependencies have deprecated.
exec "$LOWEST/bin/python" -m pytest -q -W ignore::DeprecationWarning -p no:cacheprovider tests/test_tree.py tests/test_metrics.py \
    tests/test_traversal.py tests/test_rays.py tests/test_loading_text.py tests/test_loading_gltf.py \
    tests/test_plot.py tests/test_report.py tests/test_cli.py tests/test_cluster.py
