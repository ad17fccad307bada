#!/bin/sh
# Tests of the package from the administrator's view: install, enable, run, disturb, upgrade, remove. Runs as
# root in a virtual machine of its own (`cargo xtask test host`), never on a host. The steps build on each
# other. The folder of this script contains takt.deb, takt-next.deb of a later version, and swing.net. The output
# has the form of a Rust test binary, so that the runner counts these tests, too.

here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
arm_log="$work/arm.log"
failures=0
passed=0

# --- tools -------------------------------------------------------------------------------------------

# wait_for SECONDS COMMAND...: retries until the command succeeds.
wait_for() {
    timeout_s=$1
    shift
    until "$@" >/dev/null 2>&1; do
        timeout_s=$((timeout_s - 1))
        if [ "$timeout_s" -le 0 ]; then
            echo "did not happen: $*"
            return 1
        fi
        sleep 1
    done
}

property() { systemctl show --value --property "$1" takt; }
is() { [ "$(property "$1")" = "$2" ]; }
status_says() { property StatusText | grep -q -e "$1"; }
journal_says() { journalctl --no-pager --output cat --unit takt | grep -q -e "$1"; }
state_says() { grep -q -e "$1" /var/lib/takt/state.json; }
arm_is() { tail -n 1 "$arm_log" | grep -q "^$1,"; }
restarted_at_least() { [ "$(property NRestarts)" -ge "$1" ]; }
net_is() { takt net list | grep "^$1 " | grep -q "$2"; }
# A command that must fail; the shell does not count a plain `!`.
not() { if "$@"; then return 1; fi; }

# The emulated robot controller: slow, as the whole machine.
start_arm() {
    takt emulate lwr --period 20ms >"$arm_log" 2>&1 &
    echo $! >"$work/arm.pid"
}

# Loads swing.net so that it takes a minute, starts it, and prints its name.
start_slow_swing() {
    sed "s/Max='1'/Max='60'/; s/Second='1'/Second='60'/" "$here/swing.net" >"$work/slow.net"
    takt net load --start "$work/slow.net"
}

# The measured position of the arm's joint, rad, from a monitoring net.
position() {
    monitor=$(takt net load --start "$work/monitor.net")
    # The first line of a value is printed at once; then the watch ends.
    timeout 10 takt net watch "$monitor" | sed -n '/^measured /{s///p;q}'
    takt net abort "$monitor" >&2
    takt net unload "$monitor" >&2
}

cat >"$work/monitor.net" <<EOF
{
  monitor=RobotArm::JointMonitor(Robot='left', Axis='6'),
  measured=Core::DoubleNetcommOut(inValue=monitor.outMeasuredPosition, Key='measured'),
  cancel=Cancel(), outTerminate=cancel.outCancel
}
EOF

# differ A B LIMIT: whether two numbers differ by more than the limit.
differ() { awk "BEGIN { d = $1 - $2; exit !(d > $3 || -d > $3) }"; }

# override SETTING: as `systemctl edit --runtime`. Processors here may be emulated, and stall for seconds when
# their host is busy: the watchdog needs a longer timeout than with a robot.
override() {
    mkdir -p /run/systemd/system/takt.service.d
    printf '[Service]\nWatchdogSec=20\n%s\n' "$1" >/run/systemd/system/takt.service.d/override.conf
    systemctl daemon-reload
}

write_cell() {
    cat >/etc/takt/cell.toml <<EOF
[controller]
period = "20ms"
cpus = [1]
$1
[[device]]
name = "left"
type = "kuka_lwr_fri"
listen = "127.0.0.1:49938"
EOF
}

# --- the steps ---------------------------------------------------------------------------------------

package_install_starts_nothing() {
    dpkg -i "$here/takt.deb"
    id takt
    [ -f /etc/takt/cell.toml ]
    [ -f /usr/share/man/man1/takt.1.gz ]
    is LoadState loaded
    is ActiveState inactive
    [ "$(systemctl is-enabled takt)" = disabled ]
}

doctor_checks_real_time_kernel() {
    # An emulated machine fails some checks: its clock is slow. That is status 1; 2 would be an error of the tool.
    status=0
    takt doctor >"$work/doctor.txt" || status=$?
    cat "$work/doctor.txt"
    [ "$status" -eq 1 ]
    doctor_says() { grep -q -e "^ *$1  *$2 " "$work/doctor.txt"; }
    doctor_says ok preemption
    doctor_says ok service-unit
    not doctor_says FAIL 'service-[a-z]*'
    not doctor_says WARN 'service-[a-z]*'
    takt doctor --json >"$work/doctor.json" || [ $? -eq 1 ]
    [ "$(grep -o '"status":' "$work/doctor.json" | wc -l)" -ge 20 ]
}

jitter_measures_on_real_time_kernel() {
    takt jitter --period 10ms --duration 3s --json >"$work/jitter.json"
    takt jitter --from "$work/jitter.json" >"$work/jitter.txt"
    cat "$work/jitter.txt"
    grep -q 'SMP PREEMPT_RT' "$work/jitter.txt"
    grep -q 'SCHED_FIFO 80' "$work/jitter.txt"
    grep -q ' 0 allocations in measuring threads' "$work/jitter.txt"
    # Columns: processor, cycles, missed.
    awk '$1 == "any" && NF > 4 { found = $2 > 100 } END { exit !found }' "$work/jitter.txt"
}

service_start_notifies_readiness() {
    write_cell ''
    override ''
    systemctl enable --now takt
    is ActiveState active
    is Type notify
    status_says 'left is offline'
    journal_says 'left waits for its robot'
    # The program itself reports that it is active.
    takt net list
}

cycles_are_real_time_within_the_sandbox() {
    pid=$(property MainPID)
    ps -L -o user=,cls=,rtprio=,comm= -p "$pid"
    ps -L -o user=,cls=,rtprio=,comm= -p "$pid" | grep -q '^takt *FF *80 takt-'
    ps -L -o user=,cls=,rtprio=,comm= -p "$pid" | grep -q '^takt *FF *85 takt-left'
    ps -o cls= -p "$pid" | grep -q TS
    grep '^VmLck' "/proc/$pid/status"
    [ "$(awk '/^VmLck/ {print $2}' "/proc/$pid/status")" -gt 1000 ]
    # CAP_NET_RAW and nothing else.
    grep -q '^CapBnd:[[:space:]]*0*2000$' "/proc/$pid/status"
    not journal_says 'warning: '
}

security_exposure_is_below_threshold() {
    systemd-analyze security --no-pager takt | tail -n 1
    systemd-analyze security --no-pager --threshold=25 takt >/dev/null
}

log_has_fields() {
    start_arm
    wait_for 60 status_says 'left is operational'
    journalctl --no-pager --output cat --unit takt TAKT_DEVICE=left
    journalctl --no-pager --output cat --unit takt TAKT_DEVICE=left TAKT_NOW=operational | grep -q device
}

net_moves_emulated_arm() {
    net=$(takt net load "$here/swing.net")
    timeout 120 takt net watch "$net" >"$work/watch.log" &
    wait_for 20 grep -q READY "$work/watch.log"
    takt net start "$net"
    wait $!
    cat "$work/watch.log"
    sed -n 's/^measured //p' "$work/watch.log" | awk '
        NR == 1 { min = $1; max = $1 }
        { if ($1 < min) min = $1; if ($1 > max) max = $1 }
        END { exit !(NR > 1 && max - min > 0.3) }'
    tail -n 1 "$work/watch.log" | grep -q TERMINATED
}

reload_keeps_running_net() {
    net=$(start_slow_swing)
    pid=$(property MainPID)
    write_cell 'log = "debug"'
    cat >>/etc/takt/cell.toml <<EOF
[[device]]
name = "right"
type = "kuka_lwr_fri"
listen = "127.0.0.1:49939"
EOF
    systemctl reload takt
    wait_for 20 status_says 'right is offline'
    net_is "$net" RUNNING
    # A device that a net uses stays, and settings that need a restart are reported.
    sed -i 's/49938/49940/; s/20ms/40ms/' /etc/takt/cell.toml
    systemctl reload takt
    wait_for 20 status_says 'period needs a restart'
    status_says 'device left stays'
    net_is "$net" RUNNING
    # Everything stays if the cell cannot be read.
    echo '[[dev' >>/etc/takt/cell.toml
    systemctl reload takt
    wait_for 20 status_says 'the cell stays as it is'
    net_is "$net" RUNNING
    [ "$(property MainPID)" = "$pid" ]
    is ActiveState active
    write_cell ''
    systemctl reload takt
    wait_for 20 status_says 'reloaded'
    not status_says 'right'
    takt net cancel "$net"
    wait_for 20 net_is "$net" TERMINATED
}

kill_stops_robot_and_next_start_reports_it() {
    net=$(start_slow_swing)
    wait_for 20 state_says "$net"
    from=$(position)
    sleep 2
    differ "$from" "$(position)" 0.001
    arm_is CMD
    # Time to check the robot in between.
    override 'RestartSec=15'
    kill -9 "$(property MainPID)"
    wait_for 12 arm_is MON
    tail -n 3 "$arm_log"
    is SubState auto-restart
    override ''
    wait_for 60 is ActiveState active
    is NRestarts 1
    journal_says "broken off while running $net"
    status_says "broken off while running $net"
    # It is not resumed.
    wait_for 60 status_says 'left is operational'
    status_says 'no net runs'
    from=$(position)
    sleep 2
    not differ "$from" "$(position)" 0.001
}

watchdog_restarts_hanging_net_thread() {
    restarts=$(property NRestarts)
    # Cycles run on processor 1 only. A thread of higher priority there starves them, while the rest of the
    # program continues.
    sysctl -q kernel.sched_rt_runtime_us=-1
    # The process that ends it must run on the other processor.
    taskset -c 0 timeout -s KILL 50 taskset -c 1 chrt -f 90 sh -c 'while :; do :; done' || true
    wait_for 150 journal_says 'Watchdog timeout'
    wait_for 150 is ActiveState active
    [ "$(property NRestarts)" -gt "$restarts" ]
    sysctl -q kernel.sched_rt_runtime_us=950000
    wait_for 150 status_says 'left is operational'
}

upgrade_keeps_running_net() {
    net=$(start_slow_swing)
    pid=$(property MainPID)
    dpkg -i "$here/takt-next.deb"
    dpkg-query --show takt
    [ "$(dpkg-query --show --showformat='${Version}' takt)" != "$(dpkg-deb --field "$here/takt.deb" Version)" ]
    net_is "$net" RUNNING
    [ "$(property MainPID)" = "$pid" ]
    [ "$(systemctl is-enabled takt)" = enabled ]
    # The administrator's file is kept, without a prompt.
    grep -q '20ms' /etc/takt/cell.toml
}

stop_brings_all_devices_to_rest() {
    # The net of the previous step still runs.
    state_says RUNNING
    timeout 30 systemctl stop takt
    is ActiveState inactive
    is Result success
    state_says '"stopped": true'
    not state_says RUNNING
    not journal_says 'is aborted'
    not journal_says 'came to rest within'
    systemctl start takt
    wait_for 60 status_says 'left is operational'
    not status_says 'broken off'
}

wrong_cell_is_not_restarted() {
    echo 'nonsense' >>/etc/takt/cell.toml
    not systemctl restart takt
    sleep 3
    is ActiveState failed
    is NRestarts 0
    journal_says 'nonsense'
    write_cell ''
    systemctl restart takt
    is ActiveState active
}

missing_address_is_waited_for() {
    write_cell ''
    sed -i 's/127.0.0.1:49938/10.99.0.1:49938/' /etc/takt/cell.toml
    not systemctl restart takt
    # More often than systemd's own limit allows.
    wait_for 60 restarted_at_least 7
    not is ActiveState failed
    ip address add 10.99.0.1/32 dev lo
    wait_for 60 is ActiveState active
    ip address del 10.99.0.1/32 dev lo
    write_cell ''
    systemctl restart takt
    is ActiveState active
}

removal_and_purge_leave_no_files() {
    kill "$(cat "$work/arm.pid")"
    dpkg -r takt
    not pgrep -x takt
    [ ! -e /usr/bin/takt ]
    [ -f /etc/takt/cell.toml ]
    dpkg --purge takt
    is LoadState not-found
    left=$(find / -xdev -path /proc -prune -o -path /opt -prune -o -path /tmp -prune -o -path '*takt*' -print |
        grep -v -e /takt-test -e '^/var/log/' -e '^/run/' || true)
    echo "$left"
    [ -z "$left" ]
}

# --- running them ------------------------------------------------------------------------------------

step() {
    (
        set -e
        "$1"
    ) >"$work/step.log" 2>&1
    if [ $? -eq 0 ]; then
        passed=$((passed + 1))
        echo "test service::$1 ... ok"
        return
    fi
    failures=$((failures + 1))
    echo "test service::$1 ... FAILED"
    sed 's/^/    /' "$work/step.log"
    systemctl --no-pager --full status takt 2>&1 | head -n 12 | sed 's/^/    /'
    journalctl --no-pager --lines 20 --unit takt | sed 's/^/    /'
    tail -n 5 "$arm_log" 2>/dev/null | sed 's/^/    arm: /'
}

steps=$(sed -n 's/^\([a-z_]*_[a-z_]*\)() {$/\1/p' "$0" |
    grep -v -e wait_for -e write_cell -e start_arm -e start_slow_swing)
echo "running $(echo "$steps" | wc -l) tests"
for name in ${1:-$steps}; do
    step "$name"
done
verdict=ok
[ "$failures" -eq 0 ] || verdict=FAILED
echo "test result: $verdict. $passed passed; $failures failed; 0 ignored; 0 measured; 0 filtered out"
