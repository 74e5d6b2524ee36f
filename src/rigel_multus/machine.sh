#!/bin/sh
# Keeps the files that CNI needs on a machine, from inside a pod. Multus' daemon removes its own
# configuration when it ends, and pods that start until it is back silently get no second network.
# So the daemon writes into the pod; this script puts the files onto the machine and leaves them there.
# An upgrade of the machine's software may remove programs; this script restores them.
#
#   machine.sh keep    keep the files until a signal ends it
#   machine.sh ready   succeed if all files are in place, else print what is missing
#   machine.sh copy    copy an image's standard CNI programs ($STANDARD) to $BROUGHT
#
# PART is multus or whereabouts. With RETIRED=1 it removes what it has put there: the configuration
# at once, the programs when it ends.
# Needs sh, chmod, cmp, cp, mkdir, mv, rm, rmdir, sleep.
set -u
umask 077

# The names of the programs that we have put there, for later pods and for the removal.
OWN="$BIN_DIR/.rigel-$PART"
CONF="$CONF_DIR/00-multus.conf"
ACCOUNT=/var/run/secrets/kubernetes.io/serviceaccount

fail() {
    echo "$*"
    exit 1
}

# put FILE NAME: install FILE as the program NAME; at every moment it is complete or missing.
put() {
    cp "$1" "$BIN_DIR/.$2.new" && chmod 0755 "$BIN_DIR/.$2.new" && mv -f "$BIN_DIR/.$2.new" "$BIN_DIR/$2" &&
        { listed "$2" || echo "$2" >>"$OWN"; } && echo "put $2 into $BIN_DIR"
}

listed() {
    [ -f "$OWN" ] || return 1
    while read -r name; do
        [ "$name" = "$1" ] && return 0
    done <"$OWN"
    return 1
}

there() { [ -x "$BIN_DIR/$2" ]; }
same() { cmp -s "$1" "$BIN_DIR/$2"; }

# programs there|same: install all programs that are missing (there) or differ (same). Programs that
# others have put there stay.
programs() {
    [ -d "$BIN_DIR" ] || return 0
    for program in $PROGRAMS; do
        "$1" "$SOURCE/$program" "$program" || put "$SOURCE/$program" "$program"
    done
    for file in "$BROUGHT"/*; do
        program=${file##*/}
        [ -f "$file" ] || continue
        if [ ! -e "$BIN_DIR/$program" ] && [ ! -h "$BIN_DIR/$program" ]; then
            put "$file" "$program"
        elif listed "$program"; then
            "$1" "$file" "$program" || put "$file" "$program"
        fi
    done
}

# What runs every two seconds starts no other process, to leave the processor to the robot.

# content FILE: set $content to what FILE contains; fails if it does not exist.
content() {
    [ -r "$1" ] || return 1
    content='' line=''
    while IFS= read -r line; do
        content="$content$line
"
    done <"$1"
    content="$content$line"
}

# text FILE TEXT: write TEXT to FILE if FILE differs.
text() {
    [ -f "$1" ] && content "$1" && [ "$content" = "$2" ] && return 0
    printf '%s' "$2" >"$1.new" && mv -f "$1.new" "$1"
}

# same_text FILE AS: make the contents of FILE those of AS.
same_text() {
    content "$2" && text "$1" "$content"
}

# The daemon's configuration, once it is written completely. It names the file of the primary network.
# Before Multus 4.3 takes a pod off the network, it loses most of a list of plugins in such a file
# (multus#1449), so addresses are not released. It does not lose what is in the configuration itself:
# so the file's contents are put there.
configuration() {
    content "$GENERATED/00-multus.conf" || return 0
    written=${content%"
"}
    case "$written" in
        *'"clusterNetwork":"'*\}) ;;
        *) return 0 ;;
    esac
    rest=${written#*'"clusterNetwork":"'}
    file=${rest%%'"'*}
    [ -s "$file" ] || return 0
    content "$file" || return 0
    primary=${content%"
"}
    text "$CONF" "${written%%'"clusterNetwork":"'*}\"delegates\":[$primary]${rest#*'"'}"
}

# The files that the program whereabouts reads on the machine; kubelet renews the token, we copy it.
account() {
    [ -d "$IPAM_DIR" ] || mkdir -p "$IPAM_DIR"
    same_text "$IPAM_DIR/ca.crt" "$ACCOUNT/ca.crt"
    same_text "$IPAM_DIR/token" "$ACCOUNT/token"
    text "$IPAM_DIR/nodename" "$NODE"
    case "$KUBERNETES_SERVICE_HOST" in
        *:*) host="[$KUBERNETES_SERVICE_HOST]" ;;
        *) host=$KUBERNETES_SERVICE_HOST ;;
    esac
    text "$IPAM_DIR/whereabouts.kubeconfig" "apiVersion: v1
kind: Config
current-context: whereabouts
clusters:
- name: cluster
  cluster: {server: \"https://$host:$KUBERNETES_SERVICE_PORT\", certificate-authority: ca.crt}
users:
- name: whereabouts
  user: {tokenFile: token}
contexts:
- name: whereabouts
  context: {cluster: cluster, user: whereabouts, namespace: $NAMESPACE}
"
    text "$IPAM_DIR/whereabouts.conf" "{
  \"datastore\": \"kubernetes\",
  \"configuration_path\": \"$IPAM_PATH\",
  \"kubernetes\": {\"kubeconfig\": \"$IPAM_PATH/whereabouts.kubeconfig\"}
}
"
}

keep() {
    trap 'leave' TERM INT
    [ -d "$BIN_DIR" ] || echo "the directory $BIN_DIR does not exist on this machine"
    how=same
    while :; do
        if [ -n "$RETIRED" ]; then
            retire
        else
            programs $how
            case $PART in
                multus) configuration ;;
                whereabouts) account ;;
            esac
        fi
        how=there
        sleep 2 &
        wait $!
    done
}

retire() {
    case $PART in
        multus) rm -f "$CONF" ;;
        whereabouts)
            rm -rf "$IPAM_DIR"
            rmdir "${IPAM_DIR%/*}" 2>/dev/null # fails if it contains files of others
            ;;
    esac
    return 0
}

leave() {
    if [ -n "$RETIRED" ]; then
        [ -f "$OWN" ] && while read -r name; do
            rm -f "$BIN_DIR/$name"
        done <"$OWN"
        rm -f "$OWN"
    fi
    exit 0
}

# Succeeds if a primary network, which Multus calls, has a configuration.
primary() {
    for file in "$CONF_DIR"/*.conf "$CONF_DIR"/*.conflist; do
        [ -f "$file" ] && [ "$file" != "$CONF" ] && return 0
    done
    return 1
}

ready() {
    if [ -n "$RETIRED" ]; then
        [ "$PART" = whereabouts ] || [ ! -e "$CONF" ] || fail "$CONF still exists"
        [ "$PART" = multus ] || [ ! -e "$IPAM_DIR" ] || fail "$IPAM_DIR still exists"
        exit 0
    fi
    [ -d "$BIN_DIR" ] || fail "the directory $BIN_DIR does not exist: set network.install.cni_bin_dir to the directory with this machine's CNI programs"
    for program in $PROGRAMS $NEEDED; do
        [ -x "$BIN_DIR/$program" ] || fail "the program $program is missing in $BIN_DIR: set network.install.plugins_image to an image that has it"
    done
    case $PART in
        multus)
            primary || fail "$CONF_DIR has no CNI configuration: set network.install.cni_conf_dir to the directory with this machine's"
            [ -f "$CONF" ] || fail "Multus' daemon has not written its configuration yet"
            ;;
        whereabouts) [ -f "$IPAM_DIR/whereabouts.conf" ] || fail "$IPAM_DIR/whereabouts.conf is not written yet" ;;
    esac
}

copy() {
    for program in $STANDARD; do
        [ -f "/opt/cni/bin/$program" ] && cp "/opt/cni/bin/$program" "$BROUGHT/$program"
    done
    [ -f "$BROUGHT/macvlan" ] || fail "this image has no /opt/cni/bin/macvlan: set network.install.plugins_image to an image that has it"
}

"$1"
