# Sourced by each example's `demo`: a cluster of its own (or CONTEXT=... and REGISTRY=...), with a
# base image that the example is built on. Sets CONTEXT, REGISTRY, BASE_IMAGE; defines say and rigel.

say() {
  local bold="" plain=""
  [ -t 1 ] && bold=$'\033[1m' plain=$'\033[0m'
  printf '\n%s==> %s%s\n' "$bold" "$*" "$plain"
}

rigel() { rigel-k8s --context "$CONTEXT" "$@"; }

# local_cluster NAME [OPTIONS of cluster up]: takes CONTEXT, or makes a cluster; fails without REGISTRY.
local_cluster() {
  cluster="$1"
  shift
  if [ -n "${CONTEXT:-}" ]; then
    if [ -z "${REGISTRY:-}" ]; then
      echo "error: CONTEXT=$CONTEXT also needs REGISTRY=<host/path>: where images are pushed to, and what" \
        "the cluster pulls from" >&2
      exit 2
    fi
    return
  fi
  CONTEXT="rigel-$cluster"
  rigel-k8s cluster up --name "$cluster" "$@"
  REGISTRY="$(rigel-k8s cluster status --name "$cluster" -o json |
    python3 -c 'import json, sys; print(json.load(sys.stdin)["registry"])')"
}

# base_image COMMAND TAG OFFICIAL: on a cluster of our own COMMAND builds ros:TAG, else OFFICIAL is pulled.
base_image() {
  if [ "$CONTEXT" = "rigel-$cluster" ]; then
    BASE_IMAGE="$REGISTRY/ros:$2"
    say "A base image from packages, as $BASE_IMAGE"
    rigel-k8s image "$1" --push "$BASE_IMAGE"
  fi
  export REGISTRY BASE_IMAGE="${BASE_IMAGE:-$3}"
}

# What to try next, ended by how to take the cluster away.
next_steps() {
  cat
  if [ "$CONTEXT" = "rigel-$cluster" ]; then
    echo "  $(command -v rigel-k8s) cluster down --name $cluster      # and the cluster"
  fi
}
