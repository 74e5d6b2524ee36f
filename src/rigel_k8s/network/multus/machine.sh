#!/bin/sh
# Keeps the files that CNI needs on a machine, from inside of a pod. Multus' daemon takes its own
# configuration away when it ends, and pods that start until it is back silently get no second
# network; so the daemon writes into the pod, and this puts it onto the machine and leaves it there.
# An upgrade of the machine's software may take programs away; this brings them back.
#
#   machine.sh keep    until it is told to end; ready says how far it is
#   machine.sh ready   succeeds when all is in its place, else says what is missing
#   machine.sh copy    puts an image's standard CNI programs ($STANDARD) into $BROUGHT
#
# PART is multus or whereabouts. With RETIRED=1 it takes away what it had put there: configuration
# at once, programs when it ends.
# Needs sh, chmod, cmp, cp, mkdir, mv, rm, rmdir, sleep.
set -u
umask 077

# The names of the programs that we have put there, for our successors and for the end.
OWN="$BIN_DIR/.rigel-$PART"
CONF="$CONF_DIR/00-multus.conf"
ACCOUNT=/var/run/secrets/kubernetes.io/serviceaccount

fail() {
    echo "$*"
    exit 1
}

# put FILE NAME: have FILE as the program NAME; at every moment it is whole or not there.
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

# programs there|same: have all programs in their place. What others have put there stays.
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

# What is looked at every two seconds is looked at without another process: robots have other work.

# content FILE: have in $content what FILE holds; fails where it is not there.
content() {
    [ -r "$1" ] || return 1
    content='' line=''
    while IFS= read -r line; do
        content="$content$line
"
    done <"$1"
    content="$content$line"
}

# text FILE TEXT: have TEXT as FILE, written anew only where it differs.
text() {
    [ -f "$1" ] && content "$1" && [ "$content" = "$2" ] && return 0
    printf '%s' "$2" >"$1.new" && mv -f "$1.new" "$1"
}

# same_text FILE AS: have as FILE what AS holds.
same_text() {
    content "$2" && text "$1" "$content"
}

# The daemon's configuration, once it has written the whole of it. It names the file of the primary
# network; Multus 4.3 forgets most of what a list of plugins in such a file says before it takes a
# pod off the network again (multus#1449), and no address comes back. What stands in the
# configuration itself is kept: so the file's content goes there.
configuration() {
    content "$GENERATED/00-multus.conf" || return 0
    told=${content%"
"}
    case "$told" in
        *'"clusterNetwork":"'*\}) ;;
        *) return 0 ;;
    esac
    rest=${told#*'"clusterNetwork":"'}
    file=${rest%%'"'*}
    [ -s "$file" ] || return 0
    content "$file" || return 0
    primary=${content%"
"}
    text "$CONF" "${told%%'"clusterNetwork":"'*}\"delegates\":[$primary]${rest#*'"'}"
}

# What the program whereabouts reads on the machine; kubelet renews the token, we bring it there.
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
    [ -d "$BIN_DIR" ] || echo "there is no directory $BIN_DIR on this machine"
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
            rmdir "${IPAM_DIR%/*}" 2>/dev/null # only where nobody else uses it
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

# Whether a primary network's configuration is there, for Multus to hand on to.
primary() {
    for file in "$CONF_DIR"/*.conf "$CONF_DIR"/*.conflist; do
        [ -f "$file" ] && [ "$file" != "$CONF" ] && return 0
    done
    return 1
}

ready() {
    if [ -n "$RETIRED" ]; then
        [ "$PART" = whereabouts ] || [ ! -e "$CONF" ] || fail "$CONF is still there"
        [ "$PART" = multus ] || [ ! -e "$IPAM_DIR" ] || fail "$IPAM_DIR is still there"
        exit 0
    fi
    [ -d "$BIN_DIR" ] || fail "there is no directory $BIN_DIR: network.install.cni_bin_dir says where this machine keeps CNI programs"
    for program in $PROGRAMS $NEEDED; do
        [ -x "$BIN_DIR/$program" ] || fail "there is no program $program in $BIN_DIR: network.install.plugins_image says which image brings it"
    done
    case $PART in
        multus)
            primary || fail "there is no CNI configuration in $CONF_DIR: network.install.cni_conf_dir says where this machine keeps it"
            [ -f "$CONF" ] || fail "Multus' daemon has not written its configuration yet"
            ;;
        whereabouts) [ -f "$IPAM_DIR/whereabouts.conf" ] || fail "there is no $IPAM_DIR/whereabouts.conf yet" ;;
    esac
}

copy() {
    for program in $STANDARD; do
        [ -f "/opt/cni/bin/$program" ] && cp "/opt/cni/bin/$program" "$BROUGHT/$program"
    done
    [ -f "$BROUGHT/macvlan" ] || fail "this image has no /opt/cni/bin/macvlan: network.install.plugins_image must be one that has"
}

"$1"
