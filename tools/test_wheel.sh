#!/bin/sh
# Build wheel and sdist, install each into an environment of its own, and run what a user would from
# a folder that is no checkout. Needs uv.
set -eu
cd "$(dirname "$0")/.."
command -v uv >/dev/null || { echo "make test-wheel needs uv: pip install uv" >&2; exit 2; }
root=$(pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
uv build --quiet --out-dir "$work/dist" "$root"
for built in "$work"/dist/*.whl "$work"/dist/*.tar.gz; do
    echo "== $(basename "$built")"
    rm -rf "$work/venv" "$work/run"
    "${PYTHON:-python3}" -m venv "$work/venv"
    uv pip install --quiet --python "$work/venv/bin/python" "$built"
    PYTHON="$work/venv/bin/python" sh "$root/tools/ensure_llvm.sh"
    mkdir "$work/run"
    # The environment is a user's: no checkout on the path, no caches of ours.
    (
        cd "$work/run"
        unset PYTHONPATH
        export MIBVH_CACHE="$work/run/cache" PATH="$work/venv/bin:$PATH"
        mibvh doctor --json >/dev/null
        mibvh scenes list
        mibvh scenes make cornell --triangles 1000
        mibvh build cornell@1000 --builder lbvh -o tree.npz
        mibvh rays cornell@1000 --width 32 --height 24 -o rays.npz
        mibvh trace cornell@1000 tree.npz rays.npz --repeats 1
        mibvh render cornell@1000 --integrator bvh_cost --builder lbvh --spp 1 --size 32x24 -o cost.exr
        mibvh study cornell@1000 -o study --builders lbvh,bbvh --seconds 0
        mibvh report study
        mibvh notebooks -o notebooks
        test -s study/report.html -a -s cost.exr -a -s notebooks/01*.ipynb
        python -c 'import mibvh, pathlib; assert "site-packages" in mibvh.__file__'
    )
done
echo "Wheel and sdist install and run."
