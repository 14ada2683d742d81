#!/bin/sh
# Installs the servers that the tests of the sinks talk to; never fails, the tests say what is missing.
# Not part of `make test`: Debian starts these servers where a service manager runs.
packages="mosquitto prometheus influxdb"

if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    export DEBIAN_FRONTEND=noninteractive
    # shellcheck disable=SC2086  # one word per package
    apt-get install -y -qq --no-install-recommends $packages >/dev/null 2>&1 && exit 0
    # shellcheck disable=SC2086
    apt-get update -qq && apt-get install -y -qq --no-install-recommends $packages >/dev/null && exit 0
fi
echo "No servers here, the tests of the sinks will be skipped; to have them: apt-get install $packages"
exit 0
