#!/bin/sh
# Installs the packages of debian-packages.txt that are missing: install_debian_packages.sh GROUP...
# As root or with sudo that asks for no password; otherwise says what to install, and fails.
set -eu
list="$(dirname "$0")/debian-packages.txt"

if ! command -v dpkg-query >/dev/null; then
  echo "This is no Debian or Ubuntu: make sure that the likes of these are installed:"
  grep -v '^#' "$list"
  exit 0
fi

missing=
for group in "$@"; do
  for package in $(sed -n "s/^$group: *//p" "$list"); do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' ||
      missing="$missing $package"
  done
done
[ -n "$missing" ] || exit 0

if [ "$(id -u)" = 0 ]; then
  as_root=
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
  as_root=sudo
else
  echo "Debian packages are missing. Install them, then run the same command again:" >&2
  echo "  sudo apt-get install$missing" >&2
  exit 1
fi
echo "Installing$missing"
$as_root apt-get update -qq || true # an index that is a little old may do
# shellcheck disable=SC2086 # the list is split on purpose
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing || {
  echo "apt-get could not install the packages. Install them, then run the same command again:" >&2
  echo "  sudo apt-get install$missing" >&2
  exit 1
}
