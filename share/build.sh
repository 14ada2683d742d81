#!/bin/sh
# Build sources and wheel twice from copies of the committed tree, compare the bytes, check the
# metadata with twine. SOURCE_DATE_EPOCH is the time of the commit.    sh share/build.sh PYTHON
set -eu
umask 022 # so that no archive holds the builder's mask
python=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")
cd "$(dirname "$0")/.."
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)
export SOURCE_DATE_EPOCH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for round in first second; do
  mkdir "$work/$round" "$work/$round.sources"
  git archive HEAD | tar -x --no-same-permissions -C "$work/$round"
  "$python" -m build --no-isolation --outdir "$work/$round.dist" "$work/$round" >"$work/log" 2>&1 ||
    { cat "$work/log" >&2; exit 1; }
  # setuptools writes the builder's name and clock into the archive of the sources: pack it anew
  sources=$(echo "$work/$round.dist"/*.tar.gz)
  name=$(basename "$sources" .tar.gz)
  tar -xzf "$sources" -C "$work/$round.sources"
  tar --format=posix --pax-option=delete=atime,delete=ctime --sort=name --owner=0 --group=0 \
    --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" -C "$work/$round.sources" -c "$name" |
    gzip -n >"$sources"
  (cd "$work/$round.dist" && sha256sum ./*) >"$work/$round.sums"
  sleep 2 # so that a time of the clock would show
done
cat "$work/first.sums"
diff "$work/first.sums" "$work/second.sums" ||
  { echo "two builds of one commit differ" >&2; exit 1; }
[ -x .venv-dist/bin/twine ] || {
  "$python" -m venv .venv-dist
  .venv-dist/bin/pip install --quiet --disable-pip-version-check 'twine>=6'
}
.venv-dist/bin/twine check --strict "$work/first.dist"/*
mkdir -p dist
cp "$work/first.dist"/* dist/
