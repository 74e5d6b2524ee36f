# interface.sh NAME MISSING [ADDRESS]: if the pod does not have the interface NAME, prints MISSING and
# fails, so the pod does not start. Otherwise it writes the files beside it to /rigel-k8s-network, with
# the interface's IPv4 address for @ADDRESS@, and a machine-id of the pod's own.
# It runs in the application's image and needs only a POSIX shell and /proc.
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

# Converts a dotted address to a number; `reversed` does so for a word of /proc/net/route, whose bytes
# are in reverse order.
number() (
  IFS=.
  # shellcheck disable=SC2086 # splits the address into its parts
  set -- $1
  echo $((($1 << 24) + ($2 << 16) + ($3 << 8) + $4))
)
reversed() {
  echo $(((($1 & 255) << 24) + (($1 >> 8 & 255) << 16) + (($1 >> 16 & 255) << 8) + ($1 >> 24 & 255)))
}

# The kernel's trie lists the local addresses without their interfaces; its routes have the interfaces.
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
[ -n "$address" ] || fail "$interface has no IPv4 address: it got none from the network"
for file in "$source"/*.xml; do
  [ ! -e "$file" ] || fill_in <"$file" >"$target/${file##*/}"
done
own_identity >"$target/machine-id"
echo "$interface has the address $address"
