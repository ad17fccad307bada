#!/bin/sh
# Installs the independent EtherCAT masters that the peer tests drive against the emulated segment,
# into target/peers of the workspace. Needs Python 3 with venv, and the network.
set -eu
here=$(cd "$(dirname "$0")/../../.." && pwd)
venv="${CARGO_TARGET_DIR:-$here/target}/peers"
python3 -m venv "$venv"
"$venv/bin/pip" install --quiet pysoem==1.1.13 kickcat==2.5
echo "$venv/bin/python"
