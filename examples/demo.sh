# Sourced by each example's `demo`: a cluster of its own (or CONTEXT=... and REGISTRY=...), with a
# base image that the example is built on. Sets CONTEXT, REGISTRY, BASE_IMAGE; defines say, step and rigel.

. "$(dirname "${BASH_SOURCE[0]}")/../tools/steps.sh"

rigel() { rigel-k8s --context "$CONTEXT" "$@"; }

# The command that builds a base image: that of ROS 2 is for the demo and the tests alone.
build_image() {
  case "$1" in
    ros2-base) python3 -m rigel_lab "$@" ;;
    *) rigel-k8s image "$@" ;;
  esac
}

# local_cluster NAME IMAGE [OPTIONS of cluster up]: takes CONTEXT, or makes a cluster, while the base image is
# built; fails without REGISTRY.
local_cluster() {
  cluster="$1"
  local image="$2"
  shift 2
  if [ -n "${CONTEXT:-}" ]; then
    if [ -z "${REGISTRY:-}" ]; then
      echo "error: CONTEXT=$CONTEXT also needs REGISTRY=<host/path>: where images are pushed to, and what" \
        "the cluster pulls from" >&2
      exit 2
    fi
    return
  fi
  CONTEXT="rigel-$cluster"
  base_image_log="$(mktemp)"
  build_image "$image" >"$base_image_log" 2>&1 &
  base_image_build=$!
  trap 'kill "$base_image_build" 2>/dev/null || true; rm -f "$base_image_log"' EXIT
  rigel-k8s cluster up --name "$cluster" "$@"
  REGISTRY="$(rigel-k8s cluster status --name "$cluster" -o json |
    python3 -c 'import json, sys; print(json.load(sys.stdin)["registry"])')"
}

# base_image COMMAND TAG OFFICIAL: on a cluster of our own COMMAND builds ros:TAG, else OFFICIAL is pulled.
base_image() {
  if [ "$CONTEXT" = "rigel-$cluster" ]; then
    BASE_IMAGE="$REGISTRY/ros:$2"
    step "Building a base image from packages, as $BASE_IMAGE" \
      tail --pid="$base_image_build" -n +1 -f "$base_image_log"
    wait "$base_image_build" || { cat "$base_image_log" >&2; exit 1; }
    # Also under the name by which pods of other Rigelfiles find it: ros:TAG.
    for name in "$BASE_IMAGE" "$REGISTRY/library/ros:$2"; do build_image "$1" --push "$name"; done
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
