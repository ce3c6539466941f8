#!/bin/sh
# Installs a HapticLOD package on a station. It comes inside the package, as install.sh:
#
#   sh install.sh [install]  [--root DIR] [--service NAME] [--add-service] [--trust FILE.pub] [--accept-unsigned]
#   sh install.sh check      [--root DIR] [--service NAME] [--need KILOBYTES]       change nothing, say whether it would do
#   sh install.sh rollback   [--root DIR] [--service NAME]
#   sh install.sh status     [--root DIR] [--service NAME]
#
# ROOT/releases/ID/ holds each release, ROOT/current links to the one that runs, ROOT/previous to the one before, and
# ROOT/trusted_keys says whose bundles this station runs. Everything is checked before `current` changes, in one rename;
# a release that does not come up is taken back. One line "FAULT where: what; remedy" on stderr, status 1, if it fails.
set -eu
export LC_ALL=C
trap '' HUP PIPE  # a connection that breaks now must not leave half of it done

root=/opt/hapticlod service= need=0 add_service= trust= accept= health_s=3
case ${1:-install} in
    install | check | rollback | status) job=${1:-install}; [ $# = 0 ] || shift ;;
    *) job=install ;;
esac
say() { printf '%s\n' "$*" 2>/dev/null || :; }
fail() {
    printf 'FAULT %s\n' "$*" >&2 || :
    exit 1
}
while [ $# -gt 0 ]; do
    case $1 in
        --add-service) add_service=yes; service=${service:-hapticlod-station}; shift; continue ;;
        --accept-unsigned) accept=--accept-unsigned; shift; continue ;;
    esac
    [ $# -ge 2 ] || fail "$1: is no option, or lacks its value; see the head of this script"
    case $1 in
        --root) root=$2 ;;
        --service) service=$2 ;;
        --need) need=$2 ;;
        --trust) trust=$2 ;;
        --health-seconds) health_s=$2 ;;
        *) fail "$1: is no option; see the head of this script" ;;
    esac
    shift 2
done

as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi; }
service_exists() { systemctl cat "$service" >/dev/null 2>&1; }
# The releases that `current` and `previous` link to; empty where there is none.
linked() { readlink "$root/$1" 2>/dev/null | sed 's|^releases/||' || :; }
link() {
    ln -s "releases/$2" "$root/.$1.$$"
    mv -T "$root/.$1.$$" "$root/$1"  # one rename: the link is the old one or the new one, never missing
}

check() {
    parent=$root
    while [ ! -e "$parent" ]; do parent=$(dirname "$parent"); done
    [ -d "$parent" ] || fail "$root: $parent is no folder; choose another --root"
    [ -w "$parent" ] || fail "$root: $parent cannot be written by $(id -un); give it to that user, or choose another --root"
    free=$(df -Pk "$parent" | awk 'NR == 2 {print $4}')
    [ "$free" -ge "$need" ] || fail "$root: no space, $free kB are free and $need kB needed; delete something, or choose another --root"
    for program in flock sha256sum tar readlink mv; do
        command -v $program >/dev/null || fail "$program: is not installed on the station; install it"
    done
    if [ -n "$service" ] && [ -z "$add_service" ]; then
        service_exists || fail "$service: is no service of this station; add --add-service, or leave --service out"
    fi
}

# Starts the service anew and sees it alive for a while. Without a service there is nothing that could fail.
restart() {
    [ -n "$service" ] || return 0
    as_root systemctl restart "$service" || return 1
    sleep "$health_s"
    systemctl is-active --quiet "$service"
}

lock() {
    exec 9>"$root/.lock"
    flock -n 9 || fail "$root: another deployment is at work; wait for it"
}

# Makes $1 current; where it does not come up, what was current before is again, and this fails.
switch_to() {
    before=$(linked current)
    failing=$1
    # Current already, but never seen alive: this was cut off once. What it came after is written down.
    if [ "$before" = "$1" ]; then
        before=$(cat "$root/releases/$1/came_after" 2>/dev/null || :)
    else
        printf '%s\n' "$before" >"$root/releases/$1/came_after"
    fi
    undo() {
        trap '' INT TERM EXIT
        say "taking it back: ${before:-nothing} is current again"
        if [ -n "$before" ]; then
            link current "$before"
            restart || say "warning: the service does not come up with $before either"
        else
            rm -f "$root/current"
            [ -z "$service" ] || as_root systemctl stop "$service" || :
        fi
        [ -z "$trust" ] || printf '%s\n' "$trusted_before" >"$root/trusted_keys"
        [ "$job" = rollback ] || [ "$failing" = "$before" ] || rm -rf "$root/releases/$failing"
        exit 1
    }
    trap undo INT TERM EXIT
    sync
    link current "$1"
    say "current: $1"
    if ! restart; then
        printf 'FAULT %s: does not come up with %s, which was taken back; see journalctl -u %s\n' \
            "$service" "$1" "$service" >&2 || :
        exit 1
    fi
    : >"$root/releases/$1/healthy"
    trap - INT TERM EXIT
    if [ -n "$before" ] && [ "$before" != "$1" ]; then link previous "$before"; fi
    say "healthy: $1${service:+, service $service is running}"
}

install_service() {
    getent group hapticlod >/dev/null || as_root groupadd --system hapticlod
    getent passwd hapticlod >/dev/null || as_root useradd --system --gid hapticlod --no-create-home hapticlod
    sed "s|@ROOT@|$root|g" "$1/hapticlod-station.service" >"$1/unit"
    as_root install -m 644 "$1/unit" "/etc/systemd/system/$service.service"
    # For the service's group as well as for who sits at the machine.
    sed 's|TAG+="uaccess"|GROUP="hapticlod", MODE="0660", &|' "$1/70-hapticlod.rules" >"$1/rules"
    as_root install -m 644 "$1/rules" /etc/udev/rules.d/70-hapticlod.rules
    [ -e "$root/station.env" ] || printf '# Of the service: the device, and more words for hapticlod-station run.\nDEVICE=sim\nOPTIONS=\n' >"$root/station.env"
    as_root systemctl daemon-reload
    as_root udevadm control --reload || :
    as_root systemctl enable "$service"
}

install_package() {
    payload=$(cd "$(dirname "$0")" && pwd)
    case $trust in '' | /*) ;; *) trust=$PWD/$trust ;; esac
    [ -f "$payload/ID" ] || fail "$payload: is no package; unpack it again"
    id=$(cat "$payload/ID")
    need=$((need > 0 ? need : $(du -sk "$payload" | cut -f1) + 1024))
    check
    mkdir -p "$root/releases" 2>/dev/null || fail "$root: cannot be written by $(id -un); give it to that user, or choose another --root"
    root=$(cd "$root" && pwd)
    lock
    find "$root" -maxdepth 1 -name 'incoming.*' -mmin +60 -exec rm -rf {} +  # of deployments that were cut off
    stage=$root/incoming.$$
    trap 'rm -rf "$stage"' EXIT
    trap 'exit 1' INT TERM
    mkdir "$stage"
    cp -R "$payload" "$stage/package" || fail "$root: cannot take the package; is there space?"
    cd "$stage/package"
    sha256sum --quiet -c SHA256SUMS >"$stage/sums" 2>&1 ||
        fail "package: was altered or damaged ($(head -n 1 "$stage/sums")); pack or copy it again"
    station=$stage/package/hapticlod-station
    said=$("$station" --version 2>&1) ||
        fail "hapticlod-station: does not run on this machine ($(printf %s "$said" | tail -n 1)); install what it misses (libsodium23, libhidapi-hidraw0), or ship the static one, make station-static"
    say "runs here: $said"

    # Trust as it will be after this; it becomes the station's only when everything else was right.
    mkdir "$stage/config"
    cat "$root/trusted_keys" >"$stage/config/trusted_keys" 2>/dev/null || :
    if [ -n "$trust" ]; then
        grep -qxF "$(cat "$trust")" "$stage/config/trusted_keys" || cat "$trust" >>"$stage/config/trusted_keys"
    fi
    chmod 644 "$stage/config/trusted_keys"
    export HAPTICLOD_CONFIG="$stage/config"
    said=$("$station" verify bundle.hlod $accept 2>&1) || fail "$(printf %s "$said" | tail -n 1)"
    say "$said"

    knows() { "$station" --help | grep -q "^  $1 "; }
    if knows doctor; then
        "$station" doctor >doctor.txt 2>&1 && say "doctor: well" || say "doctor: found something, see releases/$id/doctor.txt"
    fi
    if knows qualify; then
        "$station" qualify bundle.hlod -o certificate.json $accept >qualify.txt 2>&1 ||
            fail "qualify: this machine does not pass ($( (grep FAIL qualify.txt || cat qualify.txt) | head -n 1 | tr -s ' ')); tune for it, or choose another machine"
        say "qualify: passed"
    else
        say "qualify: this hapticlod-station has none"
    fi
    printf 'OPTIONS_OF_RELEASE=%s\n' "$accept" >release.env
    unset HAPTICLOD_CONFIG

    if [ "$(linked current)" != "$id" ]; then
        rm -rf "$root/releases/$id"
        mv "$stage/package" "$root/releases/$id"
    fi
    [ -z "$add_service" ] || install_service "$root/releases/$id"
    trusted_before=$(cat "$root/trusted_keys" 2>/dev/null || :)
    [ -z "$trust" ] || mv "$stage/config/trusted_keys" "$root/trusted_keys"
    rm -rf "$stage"
    if [ "$(linked current)" = "$id" ] && [ -e "$root/releases/$id/healthy" ] && [ -z "$add_service" ]; then
        say "healthy: $id was current already"
    else
        switch_to "$id"
    fi
    for old in $(ls -t "$root/releases" | tail -n +4); do  # the latest three stay
        [ "$old" = "$(linked current)" ] || [ "$old" = "$(linked previous)" ] || rm -rf "$root/releases/$old"
    done
}

case $job in
    check)
        check
        now=$(linked current)
        say "would do: ${now:-nothing} is current under $root"
        ;;
    install) install_package ;;
    rollback)
        [ -d "$root" ] || fail "$root: has no release; deploy one"
        lock
        target=$(linked previous)
        [ -n "$target" ] && [ -d "$root/releases/$target" ] || fail "$root: has no release to go back to; deploy one"
        switch_to "$target"
        ;;
    status)
        [ -e "$root/current" ] || fail "$root: has no current release; deploy one"
        say "current: $(linked current)$([ -e "$root/current/healthy" ] || printf ' (never came up)')"
        before=$(linked previous)
        say "previous: ${before:-none}"
        say "bundle: $(HAPTICLOD_CONFIG=$root "$root/current/hapticlod-station" verify "$root/current/bundle.hlod" --accept-unsigned 2>&1 | tail -n 1)"
        [ -z "$service" ] || say "service: $(systemctl is-active "$service" || :)"
        ;;
esac
