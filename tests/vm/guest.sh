# Runs as the guest's process number 1: devices for programs, the emulated projector, the tests, and an end.
b=/run/busybox
. "$1" # PYTHON, UNPACKED, CHECKOUT, and the words for pytest
end() { # QEMU ends with 2 n + 1
    printf "\\$(printf %o $((16 + $1)))" | $b dd of=/dev/port bs=1 seek=244 count=1 2>/dev/null
    $b poweroff -f
}
# The compiler of shaders that SDL would draw with crashes on the emulated processor.
export SDL_RENDER_DRIVER=software SDL_FRAMEBUFFER_ACCELERATION=0
export HOME=/run PATH=/usr/sbin:/usr/bin:/sbin:/bin FPPLAB_VM=1
for library in "$UNPACKED"/usr/lib/x86_64-linux-gnu/libusb-1.0.so.0 "$UNPACKED"/lib/x86_64-linux-gnu/libkmod.so.2; do
    [ -e "/usr/lib/x86_64-linux-gnu/${library##*/}" ] || $b cp "$library" /usr/lib/x86_64-linux-gnu/
done
ldconfig

# The rules are those of the documentation, for a group as it says; programs learn of plugging from udevd.
$b mkdir -p /run/udev /etc/udev/rules.d
$b sed -n 's/^\(SUBSYSTEM\|KERNEL\)\(.*uaccess"\)$/\1\2, GROUP="plugdev", MODE="0660"/p' "$CHECKOUT/docs/hardware.md" \
    >/etc/udev/rules.d/70-fpplab.rules
$b ln -s "$UNPACKED/bin/udevadm" /run/systemd-udevd
/run/systemd-udevd --daemon || { echo "guest: no udevd"; end 1; }

cd "$CHECKOUT" || end 1
$b mkdir -p /dev/shm /dev/pts && $b mount -t tmpfs shm /dev/shm && $b mount -t devpts devpts /dev/pts
"$PYTHON" -m tests.vm.projector &
"$PYTHON" -m tests.vm.uvc &
status=0
"$PYTHON" -m pytest -p no:cacheprovider --color=no "$@" || status=1
end $status
