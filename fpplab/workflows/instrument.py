"""A rig that stays open between scans: devices, calibration and compiled code are ready for the next one."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Self

from fpplab.calibration.model import Calibration
from fpplab.core.config import read_text
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import ConfigError
from fpplab.devices import State
from fpplab.devices.rig import Mounted, Rig
from fpplab.devices.simulation import Restartable
from fpplab.patterns.plan import Plan
from fpplab.results.observer import Observer
from fpplab.results.scan import ScanResult
from fpplab.service.order import ScanOrder
from fpplab.workflows.scan import ScanRequest, request_of_order, scan_on_open_rig

CALIBRATION_NAME = "calibration.yaml"


class Instrument:
    """A rig that stays open, so that a scan takes no longer than its exposures and its points.

    Use it as `with Instrument.open("rig.yaml") as bench: result = bench.scan(plan)`. Each scan gives the
    value and leaves the files that `fpplab scan` does, as if the rig had just been opened. The rig is opened
    again where its file, or one that it names, has changed, or a device has failed. One thread at a time may
    use it.
    """

    def __init__(self, rig: Rig, calibration: Path, folder: Path) -> None:
        self._rig, self._calibration, self._folder = rig, calibration, folder
        self._file = Path(rig.source).resolve()
        self._is_open = False
        self._changed_at: dict[Path, int] = {}

    @classmethod
    def open(
        cls, rig: Path | str, calibration: Path | str | None = None, folder: Path | str = "."
    ) -> Instrument:
        """Read the rig file; `with` opens the devices.

        Parameters
        ----------
        rig : path or str
            Rig file, or the name of one that comes with fpplab.
        calibration : path or str, optional
            Written by `fpplab characterise`, for scans that name no other; by default `calibration.yaml` in
            the folder.
        folder : path or str
            Where sessions go that are given no folder of their own.

        Returns
        -------
        Instrument
            To be opened by `with`.

        Raises
        ------
        ConfigError
            There is no such rig file, or it is wrong.
        """
        folder = Path(folder)
        return cls(Rig.load(rig), Path(calibration or folder / CALIBRATION_NAME), folder)

    def __enter__(self) -> Self:
        # What a scan needs, loaded before the first one asks for it.
        import fpplab.pipeline.measuring
        import fpplab.pipeline.taking
        import fpplab.report.scans
        import fpplab.results.scan  # noqa: F401

        self._changed_at = self._rig.changed_at()
        self._rig.__enter__()
        self._is_open = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._is_open:
            self._is_open = False
            self._rig.__exit__(kind, error, trace)

    @property
    def rig(self) -> Rig:
        """The open rig."""
        return self._rig

    def scan(
        self,
        plan: Plan | Path | str,
        out: Path | str | None = None,
        mount: Mounted | None = None,
        *,
        calibration: Calibration | Path | str | None = None,
        depth_mm: DepthInterval | None = None,
        force: bool = False,
        report: bool = True,
        observer: Observer | None = None,
    ) -> ScanResult:
        """Measure as `fpplab scan` does, and leave the same files in the session.

        Parameters
        ----------
        plan : Plan, path or str
            What to project and capture: a plan, its file, or the name of one that comes with fpplab.
        out : path or str, optional
            Folder of the session; an interrupted one is completed. By default the next of `scan_0001` … in
            the instrument's folder.
        mount : tuple of str and int, optional
            Item and pose that the rig's fixture puts up first.
        calibration : Calibration, path or str, optional
            Instead of the instrument's own.
        depth_mm : tuple of float, optional
            Least and greatest distance from the camera in mm, in which the object lies; by default as plan or
            rig file state.
        force : bool
            Whether a session that exists already is replaced.
        report : bool
            Whether `report.html` is written into the session.
        observer : Observer, optional
            Notified of each stage: `exposed` comes when the last exposure is over, `result` with the points.

        Returns
        -------
        ScanResult
            Points with their verdict, which may be `useless`: `require_usable` refuses it.

        Raises
        ------
        ConfigError, DeviceError, CalibrationError, DataError
            As `fpplab.scan`.
        """
        observer = observer or Observer()
        self._renew(observer)
        named = plan if isinstance(plan, Path | str) else None
        given = self._calibration if calibration is None else calibration
        file = None if isinstance(given, Calibration) else Path(given)
        request = ScanRequest(
            rig=self._rig,
            plan=plan if isinstance(plan, Plan) else Plan.load(plan),
            calibration=given if isinstance(given, Calibration) else self.calibration_of(Path(given)),
            out=self.next_session() if out is None else Path(out),
            mount=mount,
            depth_mm=depth_mm,
            force=force,
            report=report,
            plan_name="plan" if named is None else str(named),
            calibration_file=file,
        )
        return self._run(request, observer)

    def run_order(self, order: ScanOrder, out: Path | str, observer: Observer) -> ScanResult:
        """Measure what a client of a service orders; see `scan`."""
        self._renew(observer)
        calibration = Path(order.calibration) if order.calibration else self._calibration
        request = request_of_order(order, self._rig, Path(out), calibration, self.calibration_of)
        return self._run(request, observer)

    def _run(self, request: ScanRequest, observer: Observer) -> ScanResult:
        if isinstance(self._rig.simulation, Restartable):
            self._rig.simulation.restart()
        return scan_on_open_rig(request, observer)

    def calibration_of(self, file: Path | str) -> Calibration:
        """Load a calibration, which is kept as long as its file stays as it is."""
        return _calibration(Path(file), read_text(Path(file)))

    def next_session(self) -> Path:
        """Give the first of `scan_0001` … `scan_9999` that does not exist in the instrument's folder."""
        taken = {path.name for path in self._folder.glob("scan_*")}
        for number in range(1, 10_000):
            if (name := f"scan_{number:04d}") not in taken:
                return self._folder / name
        raise ConfigError(f"{self._folder}: holds scan_0001 to scan_9999; name another folder")

    def _renew(self, observer: Observer) -> None:
        """Open the rig again where its file or one that it names has changed, or a device is in fault."""
        now = Rig.load(self._file)
        now.source = self._rig.source
        if self._is_open:
            devices = (self._rig.camera, self._rig.projector, self._rig.stage, self._rig.fixture)
            failed = any(device is not None and device.state is not State.IDLE for device in devices)
            has_changed = now.file != self._rig.file or now.changed_at() != self._changed_at
            if not failed and not has_changed:
                return
            cause = "a device failed" if failed else "the file, or one that it names, has changed"
            observer.message(f"{now.source}: {cause}; the rig is opened again")
            self.__exit__(None, None, None)
        self._rig = now
        self.__enter__()


@lru_cache(maxsize=4)
def _calibration(file: Path, text: str) -> Calibration:
    return Calibration.load(file)
