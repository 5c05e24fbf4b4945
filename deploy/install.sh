#!/bin/sh
# Installs, upgrades or removes heliocube on a Debian machine. Run it again at any time: what is there stays.
set -eu
umask 022

usage() {
  cat <<'TEXT'
usage: install.sh [--role cube|tracker|both|archive] [--from WHEEL|CHECKOUT] [--python PROGRAM] [--notify]
                  [--root DIR]
       install.sh --remove [--root DIR]

Puts the program into a Python environment under /opt/heliocube, its units and device rules under /etc, and, where there
is none yet, a configuration under /etc/heliocube. Starts nothing: nothing moves before you say so.

  --role ROLE       what this machine does (default: what an earlier run has installed, or else both, as two units);
                    archive keeps the records of many services in PostgreSQL, alone or beside what an earlier run has
                    installed
  --from PATH       a heliocube wheel, or a checkout (default: the checkout that this script is in)
  --python PROGRAM  the Python to build on, 3.11 or newer (default: python3)
  --notify          also install what sends alarms to people; an upgrade does so where /etc/heliocube/notify.people
                    exists
  --root DIR        install into the tree DIR instead of this machine
  --remove          take everything away but /etc/heliocube, /var/lib/heliocube* and the users that own them
TEXT
}

fail() {
  printf 'install.sh: %s\n' "$1" >&2
  exit 2
}

role='' from='' python=python3 root='' remove=no notify=no archive=no
while [ $# -gt 0 ]; do
  case $1 in
    -h | --help) usage; exit 0 ;;
    --remove) remove=yes; shift; continue ;;
    --notify) notify=yes; shift; continue ;;
    # An empty value comes from a variable that is not set, and an empty --root would mean this machine.
    --role | --from | --python | --root) [ -n "${2-}" ] || fail "$1 needs a value; see --help" ;;
    *) fail "'$1' is no option; see --help" ;;
  esac
  case $1 in
    --role) role=$2 ;;
    --from) from=$2 ;;
    --python) python=$2 ;;
    --root) root=$2 ;;
  esac
  shift 2
done

case $role in
  cube | tracker | archive) roles=$role ;;
  both) roles='cube tracker' ;;
  '') roles='' ;;
  *) fail "--role $role: must be cube, tracker, both or archive" ;;
esac
[ "$(id -u)" -eq 0 ] || fail 'this needs root: run it with sudo'
if [ -n "$root" ]; then
  [ -d "$root" ] || fail "--root $root: there is no such folder"
  root=$(cd "$root" && pwd)
  [ "$root" != / ] || root=''
fi

here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=deploy/steps.sh
. "$here/steps.sh"
[ ! -e "$etc/notify.people" ] || notify=yes
# An upgrade keeps the machine's roles.
[ -n "$role" ] || for each in archive cube tracker; do
  [ ! -e "$root/etc/systemd/system/heliocube-$each.service" ] || roles="$roles $each"
done
[ -n "$roles" ] || roles='cube tracker'
[ ! -e "$etc/archive.toml" ] || archive=yes
case " $roles " in *' archive '*) archive=yes ;; esac
# A package that several locks name has the same release in all of them.
locks='runtime'
[ $notify = no ] || locks="$locks notify"
[ $archive = no ] || locks="$locks archive"
requirements=''
for lock in $locks; do requirements="$requirements -r lock/$lock.txt"; done

[ ! -e "$opt/package" ] || fail 'heliocube is here as a Debian package: install a newer package, or run apt-get remove heliocube first'

if [ $remove = yes ]; then
  end_units
  remove_checkout_files
  rm -f "$root/etc/profile.d/heliocube.sh"
  rm -rf "$opt"
  reload
  say "heliocube is removed; $etc, $root/var/lib/heliocube* and the users heliocube* are left"
  exit 0
fi

# --- what is to be installed, and with what

[ -n "$from" ] || from=$(dirname "$here")
case $from in
  *.whl) [ -f "$from" ] || fail "--from $from: there is no such wheel" ;;
  *)
    [ -f "$from/pyproject.toml" ] && [ -d "$from/daemon" ] ||
      fail "--from $from: neither a heliocube wheel nor a checkout of heliocube"
    from=$(cd "$from" && pwd)
    ;;
esac

command -v "$python" >/dev/null 2>&1 || fail "there is no $python: apt-get install python3 python3-venv"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  fail "$("$python" --version) is too old, 3.11 or newer is needed: name one with --python"
"$python" -c 'import ensurepip, venv' 2>/dev/null ||
  fail "$python cannot make environments: apt-get install python3-venv"
for tool in systemd-sysusers systemd-tmpfiles; do
  command -v $tool >/dev/null 2>&1 || fail "there is no $tool: apt-get install systemd"
done

# --- the program: a release is complete or not there, and the one that runs is not touched

fingerprint() {
  {
    "$python" --version
    for lock in $locks build; do cat "$here/lock/$lock.txt"; done
    if [ -f "$from" ]; then
      cat "$from"
    else
      cd "$from"
      cat pyproject.toml
      find solar drivers sim_drivers daemon heliocube -type f ! -name '*.pyc' -print0 | LC_ALL=C sort -z |
        xargs -0 sha256sum
    fi
  } | sha256sum | cut -c1-12
}

id=$(fingerprint)
release=$opt/releases/$id
# An empty file, which a power cut may leave, is a program that succeeds and says nothing.
answers() { [ -n "$("$release/bin/heliocube" --version)" ]; }
if [ ! -e "$release/.complete" ] || ! answers 2>/dev/null; then
  say "building the environment in $release"
  # A half-built release is of no use, and a full disk needs the room. A release that did not answer is put back: a
  # service may run from it, and what keeps it from answering may pass.
  take_back() {
    rm -rf "$release" "$release.build"
    [ ! -e "$release.old" ] || mv -T "$release.old" "$release"
  }
  trap take_back EXIT
  trap 'exit 129' HUP
  trap 'exit 130' INT
  trap 'exit 143' TERM
  # If a release lies aside already, a power cut has ended a build, and what is here is what that build has left.
  [ -e "$release.old" ] || [ ! -e "$release/.complete" ] || mv -T "$release" "$release.old"
  rm -rf "$release" "$release.build"
  mkdir -p "$opt/releases"
  "$python" -m venv "$release"
  pip() { "$release/bin/python" -m pip --disable-pip-version-check --quiet "$@"; }
  # shellcheck disable=SC2086 # words
  (cd "$here" && pip install --only-binary :all: --require-hashes $requirements) ||
    fail "pip could not install what heliocube needs, see above; nothing has been changed"
  wheel=$from
  if [ -d "$from" ]; then
    # A checkout is built without the network, by the packages that the lock names, which do not stay.
    pip install --only-binary :all: --require-hashes --target "$release.build/site" -r "$here/lock/build.txt" ||
      fail "pip could not install what builds heliocube, see above; nothing has been changed"
    PYTHONPATH=$release.build/site "$release/bin/python" -m pip --disable-pip-version-check --quiet \
      wheel --no-index --no-deps --no-build-isolation --wheel-dir "$release.build/wheel" "$from" ||
      fail "heliocube could not be built, see above; nothing has been changed"
    wheel=$(echo "$release.build/wheel"/heliocube-*.whl)
  fi
  pip install --no-index --no-deps "$wheel" ||
    fail "pip could not install heliocube itself, see above; nothing has been changed"
  rm -rf "$release.build"
  answers || fail "the new environment does not run; nothing has been changed"
  # Before the mark is made: two releases that have it would both pass for the release before.
  rm -rf "$release.old"
  # The mark must not reach the disk before the release that it marks.
  sync -f "$release"
  touch "$release/.complete"
  trap - EXIT HUP INT TERM
fi

use_release "$id"

# --- its place in the system

put() { install -D -m 0644 "$here/$1" "$root$2"; }

for other in cube tracker archive; do
  unit=heliocube-$other.service
  case " $roles " in
    *" $other "*) put $unit /etc/systemd/system/$unit ;;
    *) [ ! -e "$root/etc/systemd/system/$unit" ] || say "note: $unit is here from an earlier run and stays" ;;
  esac
done
case " $roles " in
  *' archive '*)
    for unit in parquet.service parquet.timer; do put heliocube-$unit /etc/systemd/system/heliocube-$unit; done
    ;;
esac
# These two are there to be enabled, on a machine of either role.
put heliocube-dashboard.service /etc/systemd/system/heliocube-dashboard.service
put heliocube-notify.service /etc/systemd/system/heliocube-notify.service
# So is the report of every day.
put heliocube-report.service /etc/systemd/system/heliocube-report.service
put heliocube-report.timer /etc/systemd/system/heliocube-report.timer
put heliocube.rules /etc/udev/rules.d/70-heliocube.rules
put heliocube.modules-load.conf /etc/modules-load.d/heliocube.conf
put heliocube.sysusers.conf /etc/sysusers.d/heliocube.conf
put heliocube.tmpfiles.conf /etc/tmpfiles.d/heliocube.conf
put heliocube.profile.sh /etc/profile.d/heliocube.sh
mkdir -p "$root/usr/local/bin"
link /opt/heliocube/current/bin/heliocube "$root/usr/local/bin/heliocube"
systemd-sysusers ${root:+--root="$root"} heliocube.conf

# --- configuration: only what is missing

configure "$here/examples" "$roles"
systemd-tmpfiles ${root:+--root="$root"} --create heliocube.conf
# What is reported as installed has to be there after a power cut, too.
sync
reload

say "heliocube $id is installed in $opt"
for role in $roles; do
  [ "$role" != archive ] || continue
  say "next: sudo heliocube setup /etc/heliocube/$role.toml --role $role, or edit that file and check it:"
  say "      sudo -u heliocube heliocube config check --role $role /etc/heliocube/$role.toml"
done
[ "$role" = archive ] || [ -e "$etc/bridge.key" ] || say "      copy /etc/heliocube/bridge.key from the cube's machine, then run install.sh again"
if [ "$role" = archive ]; then
  say "next: edit /etc/heliocube/archive.toml, write archive.password and archive.credentials beside it, mode 0600 (docs/archive.md)"
fi
for role in $roles; do say "      systemctl enable --now heliocube-$role    (after an upgrade, use the last line instead)"; done
say "      systemctl enable --now heliocube-dashboard    (if you want the page for browsers; see $etc/dashboard.toml)"
case " $roles " in
  *' archive '*) say "      systemctl enable --now heliocube-parquet.timer    (if you want each day as Parquet files)" ;;
  *' tracker '*) say "      systemctl enable --now heliocube-report.timer    (if you want yesterday's report every night)" ;;
esac
[ $notify = no ] ||
  say "      write $etc/notify.people, mode 0600, then systemctl enable --now heliocube-notify    (docs/alarms.md)"
[ "$role" = archive ] || say 'Before the first move: docs/install.md'
units=''
for unit in tracker cube dashboard notify archive; do
  [ ! -e "$root/etc/systemd/system/heliocube-$unit.service" ] || units="$units heliocube-$unit"
done
say "After an upgrade, restart the units that run: systemctl try-restart$units"
