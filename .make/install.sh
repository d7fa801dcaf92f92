#!/bin/sh
# .make/install.sh PYTHON EXTRA: has .venv hold the package with [EXTRA], made with PYTHON. Does only what is left to do.
set -u
python=$1
extra=$2
version='import sys; print("%d.%d.%d" % sys.version_info[:3])'
wanted=$("$python" -c "$version") || exit 1

make_venv() {
    rm -rf .venv
    echo "Making .venv with $python ($wanted)"
    if "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
        "$python" -m venv .venv
        return
    fi
    # Debian and Ubuntu keep ensurepip in a package of its own. Where pip is there without it, pip can fill the venv.
    if "$python" -c 'import venv, pip' >/dev/null 2>&1 && "$python" -m venv --without-pip .venv &&
        "$python" -m pip --python .venv/bin/python install -q pip 2>/dev/null; then
        return
    fi
    rm -rf .venv
    minor=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    echo "twin-diagram: $python cannot make a virtual environment: install the package python$minor-venv" \
        "(sudo apt-get install python$minor-venv), or name another interpreter with PYTHON=…" >&2
    return 1
}

if [ "$(.venv/bin/python -c "import pip; $version" 2>/dev/null)" != "$wanted" ]; then
    make_venv || exit 1
fi
stamp=.venv/installed-$extra
if [ ! -e "$stamp" ] || [ pyproject.toml -nt "$stamp" ] || [ twin_diagram/runtime/version.py -nt "$stamp" ]; then
    # The resolver of pips before 25 can try releases for many minutes on CPython 3.10.
    .venv/bin/python -m pip install -q --upgrade 'pip>=25.1' || exit 1
    echo "Installing twin_diagram and its [$extra] dependencies into .venv (some minutes the first time)"
    .venv/bin/python -m pip install -q -e ".[$extra]" || exit 1
    touch "$stamp"
fi
