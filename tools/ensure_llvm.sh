#!/bin/sh
# See that Dr.Jit finds a libLLVM (15 or newer); as root on a system with apt, install one.
set -eu
# Dr.Jit's maximum is what LLVM 15 aborts on where the processor has AVX-512, and Mitsuba renders with it.
usable() {
    "$PYTHON" -c 'import drjit as dr, drjit.llvm as llvm
assert dr.has_backend(dr.JitBackend.LLVM)
dr.eval(dr.maximum(dr.arange(llvm.Float, 64), 3))' >/dev/null 2>&1
}

usable && exit 0
advice="install LLVM 15 or newer (Debian, Ubuntu: apt install libllvm19; macOS: brew install llvm), or point DRJIT_LIBLLVM_PATH at its libLLVM"
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "No usable libLLVM was found: installing one from the system's packages ..."
    apt-get update -qq
    for version in 19 18 17 16 15; do
        if apt-get install -y -qq "libllvm$version" >/dev/null 2>&1; then
            usable && { echo "Installed libllvm$version."; exit 0; }
        fi
    done
fi
echo "mibvh needs a libLLVM that Dr.Jit can use: $advice." >&2
exit 2
