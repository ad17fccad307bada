#!/bin/sh
# Installs the independent EtherCAT masters that the peer tests drive against the emulated segment into
# target/peers of the workspace, for who runs those tests by hand; `cargo xtask test` has its own. Needs
# Python 3 with venv, and the network.
set -eu
here=$(cd "$(dirname "$0")/../../.." && pwd)
venv="${CARGO_TARGET_DIR:-$here/target}/peers"
python3 -m venv "$venv"
"$venv/bin/pip" install --quiet --requirement "$here/ethercat/tests/peers/requirements.txt"
# Builds SOEM 2 for its Ethernet over EtherCAT; the test that needs it is skipped without, with this reason.
"$venv/bin/pip" install --quiet --requirement "$here/ethercat/tests/peers/requirements-built.txt" ||
    echo "no soemx: install gcc and libpcap-dev, then run this again" >&2
echo "$venv/bin/python"
