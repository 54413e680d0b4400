# Sourced by scripts/excite and scripts/test: makes .venv and keeps it in step with pyproject.toml.
# usage: prepare EXTRA   (EXTRA may be empty)
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"

prepare() {
  local extra="$1" venv="$root/.venv" stamp wanted python
  stamp="$venv/installed-${extra:-base}"
  wanted="$(cksum "$root/pyproject.toml")"
  [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ] && return 0
  python="${PYTHON:-python3}"
  if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
    echo "excite: $python is missing or older than 3.11; install Python 3.11 or set PYTHON=/path/to/python3.11" >&2
    return 2
  fi
  echo "excite: installing into $venv (once, about a minute)" >&2
  [ -x "$venv/bin/python" ] || "$python" -m venv "$venv" >&2 || return 2
  "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --editable "$root${extra:+[$extra]}" >&2 || return 2
  echo "$wanted" > "$stamp"
}
