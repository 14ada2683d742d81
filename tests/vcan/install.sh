#!/bin/sh
# Sees to it that a virtual CAN bus can be had; never fails, the tests say what is missing.
PATH="$PATH:/usr/sbin:/sbin"
packages="user-mode-linux kmod iproute2"
tools="linux.uml insmod ip"
if grep -q amx_tile /proc/cpuinfo; then # needs whole_registers.c
    packages="$packages gcc libc6-dev"
    tools="$tools cc"
fi

unshare --map-root-user --net ip link add dev vcan0 type vcan 2>/dev/null && exit 0
# shellcheck disable=SC2086  # one word per tool
complete() { for tool in $tools; do command -v "$tool" >/dev/null || return 1; done; }
complete && exit 0

if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "apt-get installs $packages for the tests; make test WITHOUT=kernel does without"
    export DEBIAN_FRONTEND=noninteractive
    # shellcheck disable=SC2086  # one word per package
    apt-get install -y -qq --no-install-recommends $packages >/dev/null 2>&1 && exit 0
    # shellcheck disable=SC2086
    apt-get update -qq && apt-get install -y -qq --no-install-recommends $packages >/dev/null && exit 0
fi
echo "No virtual CAN bus here, its tests will be skipped; to have one: apt-get install $packages"
exit 0
