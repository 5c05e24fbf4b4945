#!/bin/sh
# Debian's chromium without a window, which takes a third less of a processor than the whole, or the whole.
# As root chromium gives some of its threads a larger and some a smaller share of the processors (nice -8 and 5), and
# beside those Linux 6.18 holds up pseudo-terminals for seconds: tests/measurements/shares.py. As nobody it leaves them
# all alike.
program=$(command -v chromium-headless-shell || command -v chromium)
[ "$(id -u)" = 0 ] && unshare --user true 2>/dev/null && exec unshare --user "$program" "$@"
exec "$program" "$@"
