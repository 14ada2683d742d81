#!/bin/sh
# Sees to it that the live page's tests have a browser; never fails, the tests say what is missing.
packages="chromium fonts-dejavu-core"

[ -x /usr/bin/chromium ] && exit 0

if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "apt-get installs $packages for the tests; make test WITHOUT=browser does without"
    export DEBIAN_FRONTEND=noninteractive
    # shellcheck disable=SC2086  # one word per package
    apt-get install -y -qq --no-install-recommends $packages >/dev/null 2>&1 && exit 0
    # shellcheck disable=SC2086
    apt-get update -qq && apt-get install -y -qq --no-install-recommends $packages >/dev/null && exit 0
fi
echo "No browser here, its tests will be skipped; to have one: apt-get install $packages"
exit 0
