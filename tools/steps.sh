# Sourced by ./run and the examples' demos: long steps as one line each, and Debian packages.
#
# In a terminal a step's line moves, with the last words of its command. Elsewhere (a pipe, CI, NO_COLOR,
# TERM=dumb) it is printed once. Output is shown only if the command fails; the log is kept then.

say() {
  local bold="" plain=""
  [ -t 1 ] && bold=$'\033[1m' plain=$'\033[0m'
  printf '\n%s==> %s%s\n' "$bold" "$*" "$plain"
}

moves() {
  [ -t 2 ] && [ "${TERM:-dumb}" != dumb ] && [ -z "${NO_COLOR:-}" ] && [ -z "${CI:-}" ]
}

# step TITLE COMMAND...: the command's exit code, also where COMMAND is a function. In a shell of its own, so that
# its trap does not replace the caller's.
step() (
  title="$1" log="$(mktemp "${TMPDIR:-/tmp}/rigel-XXXXXX.log")" mover="" status=0 SECONDS=0
  shift
  trap end_step EXIT
  trap interrupt INT
  if moves; then
    move "$title" "$log" &
    mover=$!
  else
    printf '==> %s\n' "$title" >&2
  fi
  (trap end_by_interrupt INT && "$@") >"$log" 2>&1 </dev/null || status=$?
  stop_moving
  if [ "$status" != 0 ]; then
    if moves; then printf '==> %s\n' "$title" >&2; fi
    show_log "$log" >&2
    echo "error: this step failed with exit code $status; all its output is in $log" >&2
  elif moves; then
    printf '==> %s (%s s)\n' "$title" "$SECONDS" >&2
  fi
  exit "$status"
)

end_step() {
  stop_moving
  [ "$status" != 0 ] || rm -f "$log"
}

interrupt() {
  trap - EXIT
  end_step
  end_by_interrupt
}

# Bash goes on after Ctrl-C if the program that it waits for ends in another way than by the signal.
end_by_interrupt() {
  trap - INT
  kill -INT "$BASHPID"
}

stop_moving() {
  [ -n "$mover" ] || return 0
  kill "$mover" 2>/dev/null || true
  wait "$mover" 2>/dev/null || true
  mover=""
  printf '\r\033[K' >&2
}

# The line that moves: with a ^C of the terminal's not wider than it, or it would leave rubbish.
move() {
  trap '' INT
  set +e
  local columns title="$1" text last sign
  columns="$(stty size <&2 2>/dev/null | cut -d' ' -f2)"
  [ "${columns:-0}" -gt 0 ] || columns=80
  [ ${#title} -lt $((columns / 2)) ] || title="${title:0:$((columns / 2 - 3))}..."
  while true; do
    for sign in '|' '/' '-' \\; do
      last="$(last_words "$2")"
      text="$sign ${SECONDS} s  $title${last:+: $last}"
      printf '\r%s\033[K' "${text:0:$((columns - 3))}" >&2
      sleep 0.3
    done
  done
}

# The last line of a log without what would move the cursor.
last_words() {
  tail -c 4000 "$1" | tr '\r\t' '\n ' | tr -cd '\n -~' | sed 's/^ *//' | grep . | tail -n 1
}

# All of it where it is read later; in a terminal what fits.
show_log() {
  if moves; then tail -n 20 "$1"; else cat "$1"; fi
}

as_root() {
  if [ "$(id -u)" = 0 ]; then "$@"; else sudo -E "$@"; fi
}

# For what root is needed; a password is asked for here, since a step has no input.
need_root() {
  [ "$(id -u)" = 0 ] && return
  if command -v sudo >/dev/null; then
    sudo true
  else
    printf 'error: cannot install %s: sudo is not installed\nhint: run this as root\n' "$*" >&2
    exit 1
  fi
}

# Debian packages by the file that shows that they are there.
packages() {
  local missing=()
  while [ $# -gt 0 ]; do
    [ -e "$1" ] || [ -e "/usr$1" ] || missing+=("$2")
    shift 2
  done
  [ ${#missing[@]} = 0 ] || install "${missing[@]}"
}

install() {
  need_root "$@"
  step "Installing Debian packages: $*" update_and_install "$@"
}

update_and_install() {
  as_root apt-get update -q && as_root env DEBIAN_FRONTEND=noninteractive \
    apt-get -o Dpkg::Use-Pty=0 install -y -q --no-install-recommends "$@"
}
