# shellcheck shell=sh
# The steps that install.sh and the Debian package share; both source this file. `$root` is the tree that they work on,
# empty for this machine.

opt=${root:=}/opt/heliocube
etc=$root/etc/heliocube
live=no
if [ -z "$root" ] && [ -d /run/systemd/system ]; then live=yes; fi

# The files outside of /opt/heliocube that install.sh has laid down.
checkout_files="
/etc/systemd/system/heliocube-cube.service
/etc/systemd/system/heliocube-dashboard.service
/etc/systemd/system/heliocube-report.service
/etc/systemd/system/heliocube-report.timer
/etc/systemd/system/heliocube-notify.service
/etc/systemd/system/heliocube-archive.service
/etc/systemd/system/heliocube-parquet.service
/etc/systemd/system/heliocube-parquet.timer
/etc/systemd/system/heliocube-tracker.service
/etc/udev/rules.d/70-heliocube.rules
/etc/modules-load.d/heliocube.conf
/etc/sysusers.d/heliocube.conf
/etc/tmpfiles.d/heliocube.conf
/usr/local/bin/heliocube
"

say() { printf '%s\n' "$1"; }

link() { # TARGET LINK: replaces a link in one step
  ln -sfn "$1" "$2.new"
  mv -fT "$2.new" "$2"
}

# Makes a release of its own from hard links: a running program keeps its files, whatever dpkg replaces, and the release
# before stays. A release of the same name may be running: it stays until the new one is whole.
lay_down() { # VERSION
  release=$opt/releases/$1
  rm -rf "$release.new" "$release.old"
  mkdir -p "$opt/releases"
  cp -al "$opt/package" "$release.new"
  touch "$release.new/.complete"
  [ ! -e "$release" ] || mv -T "$release" "$release.old"
  mv -T "$release.new" "$release"
  rm -rf "$release.old"
}

# The release that was current until now may still be running, and is the way back; older ones are removed.
use_release() { # ID
  before=''
  if [ -L "$opt/current" ]; then before=$(basename "$(readlink "$opt/current")"); fi
  # The same release again: the other one is still the way back.
  [ "$1" != "$before" ] || return 0
  sync -f "$opt"
  link "releases/$1" "$opt/current"
  for old in "$opt/releases"/*; do
    case $(basename "$old") in
      "$1" | "$before") ;;
      *)
        # A dashboard that nobody has restarted may run from there: the files stay, but not as a release to go back to.
        if grep -qsF "$old/bin/" /proc/[0-9]*/cmdline; then rm -f "$old/.complete"; else rm -rf "$old"; fi
        ;;
    esac
  done
}

# Makes only what is missing; the cube's machine makes the key that the trackers' machines get from it.
configure() { # EXAMPLES ROLES
  (
    umask 027
    mkdir -p "$etc"
    for role in $2 dashboard notify; do
      # An empty file is what a power cut has left of it.
      [ -s "$etc/$role.toml" ] || install -m 0640 "$1/$role.toml" "$etc/$role.toml"
    done
    # The service reads older files as they are; this is for the people who read them.
    for role in $2; do
      "$opt/current/bin/heliocube" config migrate --keys-only "$etc/$role.toml" ||
        say "note: $etc/$role.toml is left as it is, see above"
    done
    case " $2 " in
      *' cube '*) key=$etc/bridge.key ;;
      *) key= ;;
    esac
    "$opt/current/bin/python" -I - "$etc/api.token" ${key:+"$key"} <<'PYTHON'
import sys
from pathlib import Path

from daemon.api.token import generate_token, write_token
from daemon.bridge.signing import generate_key, write_key

token, *keys = (Path(argument) for argument in sys.argv[1:])
for path in (token, *keys):
    # An empty file is what a power cut has left of it; a secret that is there is never overwritten.
    if path.exists() and not path.stat().st_size:
        path.unlink()
    if not path.exists():
        write_token(path, generate_token()) if path == token else write_key(path, generate_key())
PYTHON
  )
}

reload() {
  [ $live = yes ] || return 0
  systemctl daemon-reload
  if command -v udevadm >/dev/null 2>&1; then
    if udevadm control --reload 2>/dev/null; then
      udevadm trigger --subsystem-match=tty --action=change
    else
      say 'note: udev does not run here; its rules hold from the next boot'
    fi
  fi
}

end_units() {
  for unit in cube.service tracker.service dashboard.service notify.service archive.service report.timer parquet.timer; do
    unit=heliocube-$unit
    [ $live = no ] || ! systemctl cat "$unit" >/dev/null 2>&1 || systemctl disable --quiet --now "$unit"
    rm -f "$root/etc/systemd/system/multi-user.target.wants/$unit" "$root/etc/systemd/system/timers.target.wants/$unit"
  done
}

remove_checkout_files() {
  for file in $checkout_files; do rm -f "$root$file"; done
}
