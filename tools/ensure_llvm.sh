#!/bin/sh
# See that Dr.Jit finds a libLLVM (15 or newer). Where it does not: as root on a system with apt,
# install one; otherwise take the one of a wheel.
set -eu
usable() {
    "$PYTHON" -c 'import sys, mibvh.llvm as llvm; sys.exit(not llvm.usable())'
}

usable && exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "No usable libLLVM was found: installing one from the system's packages ..."
    apt-get update -qq || true
    for version in 19 18 17 16 15; do
        if apt-get install -y -qq "libllvm$version" >/dev/null 2>&1; then
            usable && { echo "Installed libllvm$version."; exit 0; }
        fi
    done
fi
echo "No usable libLLVM was found: installing that of the wheel karellen-llvm-core ..."
"$PYTHON" -m pip install --quiet --disable-pip-version-check "karellen-llvm-core>=23" || true
if "$PYTHON" -c 'import sys, mibvh.llvm as llvm
found = llvm.wheel_library(); sys.exit(found is None or not llvm.usable(found))'; then
    echo "mibvh uses the libLLVM of the wheel."
    exit 0
fi
"$PYTHON" -c 'import sys, mibvh.variant as v; sys.exit("mibvh needs a libLLVM that Dr.Jit can use: " + v.LLVM_HINT)' || exit 2
