#!/usr/bin/env bash
# Cross-compile a wheel for aarch64, and run it in an emulator: the kernel's C++ tests, a solve, tests. As root, with the Python of
# Debian 12; first `apt install debootstrap qemu-user-static binfmt-support g++-aarch64-linux-gnu`. Arguments replace the list of tests.
set -eu
cd "$(dirname "$0")/.."
python=$PWD/.venv/bin/python
work=${MBOCP_ARM:-$PWD/build/arm}
root=$work/root # a Debian system
platforms=(--only-binary=:all:)
for glibc in {17..36}; do platforms+=(--platform "manylinux_2_${glibc}_aarch64"); done
platforms+=(--platform manylinux2014_aarch64)
install() { "$python" -m pip install -q --disable-pip-version-check "${platforms[@]}" --target "$@"; }

mountpoint -q /proc/sys/fs/binfmt_misc || mount -t binfmt_misc binfmt_misc /proc/sys/fs/binfmt_misc
update-binfmts --enable qemu-aarch64
[ -e "$root/usr/bin/python3" ] || debootstrap --arch=arm64 --variant=minbase --include=libgomp1,python3-dev bookworm "$root"
mountpoint -q "$root/proc" || mount -t proc proc "$root/proc"
trap 'umount "$root/proc"' EXIT

# The headers and libraries of the other processor, and what its Python says of itself.
version=$("$python" -c 'import sys; print("python{}.{}".format(*sys.version_info))')
mkdir -p "$work/sysconfig"
cp "$root"/usr/lib/$version/_sysconfigdata__aarch64-linux-gnu.py "$work/sysconfig"
mapfile -t needed < <("$python" .ci/build_requirements.py | grep ==)
[ -e "$work/build_site/casadi" ] || install "$work/build_site" --no-deps "${needed[@]}"
(
    export PYTHONPATH=$work/sysconfig:$work/build_site
    export _PYTHON_SYSCONFIGDATA_NAME=_sysconfigdata__aarch64-linux-gnu _PYTHON_HOST_PLATFORM=linux-aarch64
    export CC=aarch64-linux-gnu-gcc CXX=aarch64-linux-gnu-g++
    export CMAKE_ARGS="-DCMAKE_SYSTEM_NAME=Linux -DCMAKE_SYSTEM_PROCESSOR=aarch64 -DCMAKE_SYSROOT=$root \
        -DPython_INCLUDE_DIR=$root/usr/include/$version -DPython_SOABI=${version/python3./cpython-3}-aarch64-linux-gnu"
    rm -rf "$work/plain"
    "$python" -m pip wheel -q . --no-deps --no-build-isolation -C build-dir="$work/build" --wheel-dir "$work/plain"
    "$python" -m cmake --build "$work/build" --target kernel_tests
)

rm -rf "$work/wheel" "$root/tree"
PATH=$PWD/.venv/bin:$PATH .venv/bin/auditwheel repair --exclude 'libpinocchio*' --exclude 'libcasadi*' \
    --exclude 'libboost_serialization*' --wheel-dir "$work/wheel" "$work"/plain/*.whl
packages=$root/usr/local/lib/$version/dist-packages
[ -e "$packages/casadi" ] || install "$packages" "$work"/wheel/*.whl pytest hypothesis mpmath
install "$packages" --no-deps --upgrade "$work"/wheel/*.whl
mkdir "$root/tree"
git archive HEAD . ':!mbocp' | tar -x -C "$root/tree" # what is imported is the wheel

cp "$work/build/kernel_tests" "$root/tree"
inside() {
    echo "\$ $*"
    chroot "$root" /bin/sh -c 'cd /tree; exec "$@"' sh "$@"
}
inside ./kernel_tests
inside python3 -m mbocp doctor || true # warns of the missing compiler
inside python3 -m mbocp solve examples/arms/ur5_reach.toml -q -o /tmp/reach.h5
[ $# -gt 0 ] || set -- tests/programme/test_tape.py tests/programme/test_lanes.py tests/lie
inside python3 -m pytest -q -p no:cacheprovider "$@"
