# interface.sh NAME MISSING [ADDRESS]: ends the pod's start with the line MISSING unless it has the
# interface NAME; else writes the files beside it to /rigel-k8s-network, @ADDRESS@ replaced by the
# interface's IPv4 address, and an identity of this pod's own as machine-id.
# It runs in the application's image: a POSIX shell and /proc are all that it may need.
set -eu
interface=$1 missing=$2 address=${3:-}
source=${0%/*} target=/rigel-k8s-network

fail() {
  echo "$*" >&2
  exit 1
}

is_there() {
  while read -r name _; do
    case $name in "$interface":*) return 0 ;; esac
  done </proc/net/dev
  return 1
}

# A dotted address as a number; a word of /proc/net/route, whose bytes stand in reverse, too.
number() (
  IFS=.
  # shellcheck disable=SC2086 # the parts are wanted
  set -- $1
  echo $((($1 << 24) + ($2 << 16) + ($3 << 8) + $4))
)
reversed() {
  echo $(((($1 & 255) << 24) + (($1 >> 8 & 255) << 16) + (($1 >> 16 & 255) << 8) + ($1 >> 24 & 255)))
}

# The kernel's trie has the local addresses without their interfaces, its routes have those.
local_addresses() {
  while read -r one two three; do
    case "$one $two $three" in
    "|-- "*) last=$two ;;
    "/32 host LOCAL") echo "$last" ;;
    esac
  done </proc/net/fib_trie
}

is_on_interface() {
  while read -r name network gateway _ _ _ _ mask _; do
    [ "$name $gateway" = "$interface 00000000" ] && [ "$mask" != 00000000 ] || continue
    mask=$(reversed "0x$mask")
    [ $(($1 & mask)) != "$(reversed "0x$network")" ] || return 0
  done </proc/net/route
  return 1
}

find_address() {
  for found in $(local_addresses); do
    if is_on_interface "$(number "$found")"; then
      echo "$found"
      return
    fi
  done
}

fill_in() {
  while IFS= read -r line; do
    case $line in *@ADDRESS@*) line=${line%%@ADDRESS@*}$address${line#*@ADDRESS@} ;; esac
    printf '%s\n' "$line"
  done
}

own_identity() (
  IFS=- read -r a b c d e </proc/sys/kernel/random/uuid
  printf '%s\n' "$a$b$c$d$e"
)

is_there || fail "$missing"
[ -n "$address" ] || address=$(find_address)
[ -n "$address" ] || fail "$interface has no IPv4 address: the network gave it none"
for file in "$source"/*.xml; do
  [ ! -e "$file" ] || fill_in <"$file" >"$target/${file##*/}"
done
own_identity >"$target/machine-id"
echo "$interface has the address $address"
