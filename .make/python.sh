#!/bin/sh
# Prints the interpreter to use: the one given as an argument, else the first that fits; one line on stderr otherwise.
fits='import sys; sys.exit(not (sys.implementation.name == "cpython" and (3, 10) <= sys.version_info[:2] <= (3, 12)))'
complete='import ensurepip, venv'

if [ -n "${1:-}" ]; then
    if ! "$1" -c "$fits" >/dev/null 2>&1; then
        found=$("$1" -c 'import platform; print(platform.python_implementation(), platform.python_version())' 2>/dev/null)
        echo "twin-diagram: PYTHON=$1 is ${found:-no interpreter that runs}; CPython 3.10, 3.11 or 3.12 is needed" >&2
        exit 1
    fi
    echo "$1"
    exit 0
fi
bare=
for candidate in python3.12 python3.11 python3.10 python3 python; do
    "$candidate" -c "$fits" >/dev/null 2>&1 || continue
    if "$candidate" -c "$complete" >/dev/null 2>&1; then
        echo "$candidate"
        exit 0
    fi
    bare=${bare:-$candidate}
done
if [ -n "$bare" ]; then  # install.sh says what it lacks
    echo "$bare"
    exit 0
fi
echo "twin-diagram: no CPython 3.10, 3.11 or 3.12 on the PATH; name one with PYTHON=/path/to/python3.12" >&2
exit 1
