#!/bin/busybox sh
# The first program of the guest: its root is the host's, under a layer of memory.
export PATH=/bin
b=/bin/busybox
fail() { echo "guest: $1"; $b poweroff -f; }
$b mount -t proc proc /proc
$b mount -t sysfs sys /sys
$b mount -t devtmpfs dev /dev
for module in @MODULES@; do $b modprobe $module || fail "no module $module"; done
$b mount -t tmpfs layer /layer
$b mkdir /layer/upper /layer/work
$b mount -t 9p -o trans=virtio,version=9p2000.L,ro,msize=1048576,cache=loose host /host || fail "no host's files"
$b mount -t overlay -o lowerdir=/host,upperdir=/layer/upper,workdir=/layer/work overlay /new || fail "no overlay"
for folder in proc sys dev; do $b mount --move /$folder /new/$folder; done
$b mount -t tmpfs run /new/run
$b mount -t tmpfs tmp /new/tmp
$b ip link set lo up
$b cp /bin/busybox /new/run/busybox
exec $b switch_root /new /run/busybox sh "$@" # the words behind -- on the kernel's command line
