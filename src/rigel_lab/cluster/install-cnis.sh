#!/bin/sh
# Copies the CNI programs of this image to the node. SKIP_CNI_BINARIES=a,b leaves some out;
# UPDATE_CNI_BINARIES=false keeps what is there.
set -eu
to=/host/opt/cni/bin
for program in /opt/cni/bin/*; do
    name=${program##*/}
    case ",${SKIP_CNI_BINARIES:-}," in *",$name,"*) continue ;; esac
    [ "${UPDATE_CNI_BINARIES:-true}" = true ] || [ ! -f "$to/$name" ] || continue
    cp "$program" "$to/$name"
    echo "copied $name to $to"
done
