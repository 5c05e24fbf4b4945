#!/bin/sh
# As root chromium gives some of its threads a larger and some a smaller share of the processors (nice -8 and 5), and
# beside those Linux 6.18 holds up pseudo-terminals for seconds: tests/measurements/shares.py. As nobody it leaves them
# all alike.
[ "$(id -u)" = 0 ] && unshare --user true 2>/dev/null && exec unshare --user "$CHROMIUM" "$@"
exec "$CHROMIUM" "$@"
