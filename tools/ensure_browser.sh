#!/bin/sh
# See that the report can be tested in a browser; as root on a system with apt, install one.
set -eu
usable() {
    command -v chromedriver >/dev/null &&
        { command -v chromium || command -v google-chrome || command -v chrome; } >/dev/null
}

usable && exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "No Chromium with chromedriver was found: installing one from the system's packages ..."
    apt-get update -qq && apt-get install -y -qq chromium chromium-driver >/dev/null 2>&1 || true
    usable && { echo "Installed chromium."; exit 0; }
fi
echo "The tests of the report in a browser are SKIPPED: there is no Chromium with chromedriver." >&2
