#!/usr/bin/env bash
# Build the native part with AddressSanitizer and UndefinedBehaviorSanitizer, stage functions too, and run the tests that
# drive it. Arguments replace the list of tests. The first report of a sanitizer ends the run with an error.
set -eu
cd "$(dirname "$0")/.."
python=$PWD/.venv/bin/python
build=$PWD/build/sanitize
tree=$build/tree # a copy of the package with the instrumented modules in it
mkdir -p "${build%/*}"

"$python" -m cmake -G Ninja -S mbocp/_native -B "$build" -DMBOCP_SANITIZE=ON -DCMAKE_BUILD_TYPE=None \
    -DPython_EXECUTABLE="$python" -DCMAKE_MAKE_PROGRAM="$PWD/.venv/bin/ninja" >"$build.log" ||
    { cat "$build.log" >&2; exit 1; }
"$python" -m cmake --build "$build"
rm -rf "$tree"
mkdir -p "$tree"
cp -r mbocp "$tree/mbocp"
DESTDIR=$tree "$python" -m cmake --install "$build" --prefix / >/dev/null
ln -sfn "$PWD/robots" "$tree/robots"
ln -sfn "$PWD/examples" "$tree/examples"
# The modules stay where they are; their libraries are found as in a development install.
packages=$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
cc=$build/cc
printf '#!/bin/sh\nexec %s -fsanitize=address,undefined -fno-sanitize=vptr -g1 "$@"\n' "$(command -v cc)" >"$cc"
chmod +x "$cc"

# CasADi loads IPOPT and fatrop with RTLD_DEEPBIND, which sanitizers refuse: a library in front takes the flag away.
echo '#define _GNU_SOURCE
#include <dlfcn.h>
void *dlopen(const char *name, int flags) {
    void *(*next)(const char *, int) = (void *(*)(const char *, int))dlsym(RTLD_NEXT, "dlopen");
    return next(name, flags & ~RTLD_DEEPBIND);
}' | cc -shared -fPIC -xc - -o "$build/dlopen.so"

[ $# -gt 0 ] || set -- tests/solvers tests/symbolic tests/formulation tests/programme tests/lie tests/integrators/test_schemes.py
export CC=$cc MBOCP_CACHE_DIR=$build/cache
export LD_LIBRARY_PATH=$packages/casadi:$packages/cmeel.prefix/lib
# Python itself leaks on purpose, and CasADi's plug-ins are never unloaded.
export ASAN_OPTIONS=detect_leaks=0:detect_odr_violation=0:verify_asan_link_order=0:abort_on_error=1
export UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1
export LD_PRELOAD="$build/dlopen.so $(cc -print-file-name=libasan.so) $(cc -print-file-name=libstdc++.so.6)"
# A file, and no text on the standard input: processes that tests spawn read it, too.
cat >"$build/run.py" <<'END'
import sys

# The finder of the development install would give the modules that are not instrumented.
sys.meta_path[:] = [finder for finder in sys.meta_path if "ScikitBuild" not in type(finder).__name__]
sys.path[:1] = ["build/sanitize/tree", "."]
if __name__ == "__main__":
    from mbocp._native import _kernel

    assert "build/sanitize" in _kernel.__file__, _kernel.__file__
    import pytest

    paths = "pythonpath=build/sanitize/tree ."
    sys.exit(pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-o", paths, *sys.argv[1:]]))
END
exec "$python" "$build/run.py" "$@"
