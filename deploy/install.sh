#!/bin/bash
# Install the gateway as a service on the vehicle computer, or take it away again:
#
#     deploy/install.sh [--can-path ID_PATH] [--listen-only] [--root DIR]
#     deploy/install.sh --uninstall [--root DIR]
#
# Program in /opt/hil-gateway, configuration in /etc/hil-gateway, units in /etc/systemd. Nothing is started: the guide
# (docs/bring-up.md) does that step by step. --can-path names the adapter that is to be can0 where there are several;
# --listen-only keeps its controller from transmitting and acknowledging. --root stages into DIR for images and tests.
# Uninstalling removes what was installed, and leaves recordings, and the configuration if it was edited.
set -euo pipefail
source=$(cd "$(dirname "$0")/.." && pwd)
root='' can_path='' listen_only='' uninstall=''
fail() { echo "install: $*" >&2; exit 2; }
say() { echo "install: $*" >&2; }

while [ $# -gt 0 ]; do
    case $1 in
        --root) root=${2-}; [ -n "$root" ] || fail "--root wants a directory"; shift 2 ;;
        --can-path) can_path=${2-}; [ -n "$can_path" ] || fail "--can-path wants the ID_PATH of the adapter"; shift 2 ;;
        --listen-only) listen_only=yes; shift ;;
        --uninstall) uninstall=yes; shift ;;
        *) sed -n '2,12s/^# \{0,1\}//p' "$0" >&2; exit 2 ;;
    esac
done
[[ ! $can_path || $can_path =~ ^[A-Za-z0-9:._-]+$ ]] || fail "--can-path $can_path: not an ID_PATH, as pci-0000:00:14.0-usb-0:2:1.0"
[ -n "$root" ] || [ "$(id -u)" = 0 ] || fail "must be root (sudo deploy/install.sh), or stage with --root DIR"

program=/opt/hil-gateway
configuration=/etc/hil-gateway
manifest=$root$program/installed-files

# put FILE PATH: install one file and note it down
put() {
    install -D -m 644 "$source/deploy/$1" "$root$2"
    echo "$2" >>"$manifest"
}

systemd() { [ -n "$root" ] || ! [ -d /run/systemd/system ] || systemctl "$@"; }

install_program() {
    install -d "$root$program"
    : >"$manifest"
    (cd "$source" && tar --create --exclude=__pycache__ \
        can_dbc hil_gateway estimator planner deploy docs pyproject.toml requirements.lock README.md LICENSE) |
        tar --extract --directory="$root$program" --no-same-owner
    [ -n "$root" ] || "$program/deploy/setup.sh"
}

install_configuration() {
    local file=$root$configuration/av24.toml
    if [ -f "$file" ]; then say "$configuration/av24.toml is there already: kept"; return; fi
    install -D -m 644 "$source/deploy/av24.toml" "$file"
}

install_units() {
    local unit
    for unit in hil.target hil-gateway.service hil-estimator.service hil-planner.service hil-recorder.service \
        hil-learner.service hil-receiver.service hil-dashboard.service hil-.service.d/common.conf; do
        put "systemd/$unit" "/etc/systemd/system/$unit"
    done
    put hil-gateway.sysusers /etc/sysusers.d/hil-gateway.conf
    [ -n "$root" ] || systemd-sysusers /etc/sysusers.d/hil-gateway.conf
}

install_can() {
    put can/80-can0.network /etc/systemd/network/80-can0.network
    put can/80-can0.link /etc/systemd/network/80-can0.link
    put can/hil-can.modules /etc/modules-load.d/hil-can.conf
    put can/90-hil-can.sysctl /etc/sysctl.d/90-hil-can.conf
    [ -z "$listen_only" ] || put can/80-can0.network.d/listen-only.conf /etc/systemd/network/80-can0.network.d/listen-only.conf
    if [ -n "$can_path" ]; then
        put can/70-hil-can.rules /etc/udev/rules.d/70-hil-can.rules
        sed -i "s|@ID_PATH@|$can_path|g" "$root/etc/udev/rules.d/70-hil-can.rules"
    fi
    if [ -z "$root" ]; then
        modprobe -a can can_raw || say "this kernel has no CAN modules"
        sysctl -q -p /etc/sysctl.d/90-hil-can.conf
    fi
}

remove() {
    local file
    [ -f "$manifest" ] || fail "not installed: $manifest is missing"
    systemd disable --now hil.target hil-gateway hil-estimator hil-planner hil-recorder hil-learner hil-receiver hil-dashboard \
        2>/dev/null || true
    while read -r file; do
        rm -f "$root$file"
        rmdir --ignore-fail-on-non-empty "$(dirname "$root$file")" 2>/dev/null || true
    done <"$manifest"
    if cmp -s "$root$program/deploy/av24.toml" "$root$configuration/av24.toml"; then
        rm "$root$configuration/av24.toml"
        rmdir --ignore-fail-on-non-empty "$root$configuration"
    else
        say "$configuration/av24.toml was edited: kept"
    fi
    rm -rf "${root}${program:?}"
    systemd daemon-reload
    say "removed; recordings in /var/lib/hil-gateway are kept"
}

if [ -n "$uninstall" ]; then remove; exit; fi
install_program
install_configuration
install_units
install_can
systemd daemon-reload
systemd enable systemd-networkd 2>/dev/null || true
say "done; next: docs/bring-up.md, step 8"
