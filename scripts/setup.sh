#!/usr/bin/env bash
# Make .venv ready: Debian's libraries, a virtual environment, the locked packages, fewview itself.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "setup: $*" >&2; }

python=${PYTHON:-$(command -v python3.11 || command -v python3 || true)}
[ -n "$python" ] || { say "no Python found; install python3 (3.11) and python3-venv"; exit 1; }
"$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' ||
    { say "$python is not Python 3.11, which requirements.lock is for; set PYTHON=..."; exit 1; }

missing=()
known=$(/sbin/ldconfig -p)
for pair in libusb-1.0.so.0=libusb-1.0-0 libGL.so.1=libgl1 libEGL.so.1=libegl1 libgomp.so.1=libgomp1
do
    grep -qF "${pair%=*} " <<<"$known" || missing+=("${pair#*=}")
done
"$python" -c 'import ensurepip, venv' 2>/dev/null || missing+=(python3-venv)

if [ ${#missing[@]} -gt 0 ]; then
    if [ "$(id -u)" -ne 0 ]; then
        say "Debian packages are missing; run: sudo apt-get install ${missing[*]}"
        exit 1
    fi
    say "installing ${missing[*]}"
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}"
fi

[ -x .venv/bin/python ] || "$python" -m venv .venv
say "installing the locked packages into .venv (minutes the first time)"
pip=(.venv/bin/python -m pip install --quiet --disable-pip-version-check)
"${pip[@]}" "$(grep '^torch==' requirements.lock)"
"${pip[@]}" -r requirements.lock
"${pip[@]}" --no-deps --no-build-isolation -e .
say "done"
