#!/bin/sh
# Installs the broker that the tests of the MQTT sink talk to; never fails, the tests say if it is missing.
# Not part of `make test`: Debian starts it where a service manager runs.
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    export DEBIAN_FRONTEND=noninteractive
    apt-get install -y -qq --no-install-recommends mosquitto >/dev/null 2>&1 && exit 0
    apt-get update -qq && apt-get install -y -qq --no-install-recommends mosquitto >/dev/null && exit 0
fi
echo "No broker here, its tests will be skipped; to have it: apt-get install mosquitto"
exit 0
