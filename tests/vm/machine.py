"""A small virtual machine whose kernel has a USB/IP hub, over this computer's own files.

Its root is this computer's, to be read only, under a layer that is forgotten in the end: so the checkout and
its virtual environment run there unchanged. QEMU emulates the processor, which works without any right. What
is needed comes as Debian packages, unpacked and not installed.
"""

import gzip
import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FOLDER = ROOT / "build" / "vm"
"""Unpacked packages and what is made of them; `make clean` removes it."""

QEMU, KERNEL = "qemu-system-x86", "linux-image-amd64"
IN_GUEST = ("busybox-static", "udev", "libkmod2", "libusb-1.0-0")
MODULES = (
    "virtio_pci",
    "9pnet_virtio",
    "9p",
    "overlay",
    "vhci_hcd",
    "usbhid",
    "hid_generic",
    "uvcvideo",
    "vivid",
)
LIBRARIES = ("usr/lib/x86_64-linux-gnu", "lib/x86_64-linux-gnu")
KERNELS = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "+sse2"}
"""What numba compiles for: the guest's processor and this computer's take the same."""
COMPILED_BY = "tests/drivers/test_three_devices.py"
"""What `test_three.py` does in the guest, on this computer."""
MEMORY_MB = 1536
LONGEST_S = 1500
PASSED, FAILED = 33, 35
"""How QEMU ends when the guest writes 16 or 17 to its exit port."""


class NotHere(Exception):  # noqa: N818 - no fault of the program
    """This computer cannot run the virtual machine; the message says why."""


class Machine:
    """The machine, its packages in `folder`."""

    def __init__(self, folder: Path = FOLDER) -> None:
        self._folder = folder
        self._root = folder / "root"
        self._ready = folder / "ready"
        self._installed = shutil.which("qemu-system-x86_64")

    def fetch(self) -> None:
        """Prepare everything that is not ready. Raises `NotHere`."""
        parts = (str(self._installed), QEMU, KERNEL, *IN_GUEST, *MODULES)
        recipe = "\n".join([*parts, (HERE / "init.sh").read_text("utf-8")])
        if self._ready.exists() and self._ready.read_text("utf-8") == recipe:
            return
        if sys.platform != "linux" or platform.machine() != "x86_64":
            raise NotHere("the virtual machine needs Linux on x86_64")
        for tool in ("apt-get", "apt-cache", "dpkg-deb"):
            if shutil.which(tool) is None:
                raise NotHere(f"the virtual machine is made of Debian's packages, and {tool} is not here")
        shutil.rmtree(self._folder, ignore_errors=True)
        (self._folder / "packages").mkdir(parents=True)
        self._download()
        for package in sorted((self._folder / "packages").glob("*.deb")):
            run("dpkg-deb", "-x", str(package), str(self._root))
        self._make_initramfs()
        shutil.rmtree(self._folder / "packages")
        self._ready.write_text(recipe, encoding="utf-8")

    def _download(self) -> None:
        """The kernel, what runs in the guest, and QEMU with the libraries that this computer has not."""
        depends = run("apt-cache", "depends", "--important", KERNEL).splitlines()
        kernels = [line.split()[-1] for line in depends if "Depends: linux-image" in line]
        if not kernels:
            raise NotHere(f"the virtual machine needs Debian's {KERNEL}, and apt's has no kernel")
        wanted = [kernels[0], *IN_GUEST]
        if self._installed is None:
            planned = run("apt-get", "install", "--simulate", "--no-install-recommends", QEMU)
            wanted += [line.split()[1] for line in planned.splitlines() if line.startswith("Inst ")]
        run("apt-get", "download", *dict.fromkeys(wanted), folder=self._folder / "packages")

    def _make_initramfs(self) -> None:
        """The kernel's modules, busybox, and what it runs first."""
        tree = self._folder / "initramfs"
        for folder in ("bin", "proc", "sys", "dev", "layer", "host", "new"):
            (tree / folder).mkdir(parents=True)
        busybox = str(shutil.copy(self._root / "bin" / "busybox", tree / "bin"))
        kernel = self._kernel
        run(busybox, "depmod", "-b", str(self._root), kernel)
        of_all = self._root / "lib" / "modules" / kernel
        for module in self._needed(of_all):
            copy = tree / "lib" / "modules" / kernel / module
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(of_all / module, copy)
        run(busybox, "depmod", "-b", str(tree), kernel)
        init = (HERE / "init.sh").read_text("utf-8").replace("@MODULES@", " ".join(MODULES))
        (tree / "init").write_text(init, encoding="utf-8")
        (tree / "init").chmod(0o755)
        names = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*")))
        archive = [busybox, "cpio", "-o", "-H", "newc"]
        packed = subprocess.run(archive, cwd=tree, input=names.encode(), stdout=subprocess.PIPE, check=True)
        (self._folder / "initramfs.gz").write_bytes(gzip.compress(packed.stdout, 1))
        for used_up in (tree, of_all / "kernel"):
            shutil.rmtree(used_up)

    @property
    def _kernel(self) -> str:
        (kernel,) = (path.name for path in (self._root / "lib" / "modules").iterdir())
        return kernel

    def _needed(self, modules: Path) -> Iterator[str]:
        """The files of `MODULES` and of all that they need, as depmod lists them."""
        lines = (modules / "modules.dep").read_text("utf-8").splitlines()
        listed = {name: needs.split() for name, _, needs in (line.partition(":") for line in lines)}
        files = {Path(name).name.split(".")[0].replace("-", "_"): name for name in listed}
        waiting = [files[name] for name in MODULES if name in files]
        taken: set[str] = set()
        while waiting:
            name = waiting.pop()
            if name not in taken:
                taken.add(name)
                waiting += listed[name]
                yield name

    @property
    def _compiled(self) -> dict[str, str]:
        return {**KERNELS, "NUMBA_CACHE_DIR": str(self._folder / "numba")}

    def compile(self) -> int:
        """Have numba compile here, for which the guest would need minutes; 0 when that test passed."""
        command = (sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", COMPILED_BY)
        done = subprocess.run(command, cwd=ROOT, env=os.environ | self._compiled, check=False)
        return int(done.returncode != 0)

    def run(self, words: Sequence[str]) -> int:
        """Boot and run pytest with these words, its output to stdout; 0 when all passed, else 1.

        Raises `NotHere` when the machine does not come as far as the tests.
        """
        libraries = ":".join(str(self._root / place) for place in LIBRARIES)
        unpacked = self._root / "usr" / "bin" / "qemu-system-x86_64"
        data = [str(self._root / "usr" / "share" / name) for name in ("qemu", "seabios")]
        command = [self._installed] if self._installed else [str(unpacked), "-L", data[0], "-L", data[1]]
        exported = {"PYTHON": sys.executable, "UNPACKED": str(self._root), "CHECKOUT": str(ROOT)}
        assigned = (f"{name}={shlex.quote(value)}" for name, value in (exported | self._compiled).items())
        (self._folder / "guest.env").write_text(
            f"export {' '.join(assigned)}\nset -- {shlex.join(words)}\n", encoding="utf-8"
        )
        command += [
            *("-accel", "tcg", "-cpu", "max", "-machine", "q35", "-m", str(MEMORY_MB), "-smp", "1"),
            *("-nodefaults", "-no-user-config", "-display", "none", "-no-reboot", "-serial", "stdio"),
            *("-kernel", str(self._root / "boot" / f"vmlinuz-{self._kernel}")),
            *("-initrd", str(self._folder / "initramfs.gz")),
            *("-append", f"console=ttyS0 loglevel=3 panic=-1 -- {HERE}/guest.sh {self._folder}/guest.env"),
            *("-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"),
            *("-device", "isa-debug-exit,iobase=0xf4,iosize=4"),
        ]
        environment = os.environ if self._installed else os.environ | {"LD_LIBRARY_PATH": libraries}
        try:
            done = subprocess.run(
                command, env=environment, stdin=subprocess.DEVNULL, timeout=LONGEST_S, check=False
            )
        except subprocess.TimeoutExpired:
            sys.stderr.write(f"the virtual machine was still running after {LONGEST_S} s, and was stopped\n")
            return 1
        if done.returncode not in (PASSED, FAILED):
            raise NotHere(f"the virtual machine does not start here: QEMU ends with {done.returncode}")
        return 0 if done.returncode == PASSED else 1


def run(*command: str, folder: Path | None = None) -> str:
    """Return the output of a command; raise `NotHere` with its last line if it fails."""
    done = subprocess.run(
        command,
        cwd=folder,
        capture_output=True,
        text=True,
        env=os.environ | {"LC_ALL": "C"},
        check=False,
    )
    if done.returncode:
        words = (done.stderr or done.stdout).strip().splitlines() or ["without a word"]
        raise NotHere(
            f"the virtual machine cannot be had: '{' '.join(command[:3])}' fails ({words[-1]}); "
            "it is made of Debian's packages, as of the last apt-get update"
        )
    return done.stdout
