"""What the buttons of the panel do."""

from pathlib import Path
from typing import Any, ClassVar

import bpy

from ...preview_file import read_preview
from ...scene import RenderRefused
from ..preview import show_preview, take_picture
from . import data
from .clouds import import_cloud
from .jobs import Job, JobFailedError
from .pictures import make_image
from .preferences import interpreter_of
from .settings import forget_shown, remember, settings_of, shown_preview

OperatorResult = set[str]  # what Blender expects of an operator

_FINISHED, _CANCELLED = {"FINISHED"}, {"CANCELLED"}


class _CommandOperator:
    """An operator that runs fpplab until done or Escape is pressed, and waits where there is no window."""

    bl_options: ClassVar[OperatorResult] = {"REGISTER"}
    report: Any

    def execute(self, context: Any) -> OperatorResult:
        try:
            self._job = self._start(context)
        except JobFailedError as failed:
            return self._refuse(failed)
        self._job.wait()
        return self._finish(context)

    def invoke(self, context: Any, event: Any) -> OperatorResult:
        if bpy.app.background:
            return self.execute(context)
        try:
            self._job = self._start(context)
        except JobFailedError as failed:
            return self._refuse(failed)
        manager = context.window_manager
        self._timer = manager.event_timer_add(0.2, window=context.window)  # s
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> OperatorResult:
        if event.type == "ESC":
            self._leave(context)
            self._job.close()
            self.report({"INFO"}, "cancelled")
            return _CANCELLED
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if not self._job.is_done():
            context.workspace.status_text_set(f"{self._job.last_line()} (Esc cancels)")
            return {"RUNNING_MODAL"}
        self._leave(context)
        return self._finish(context)

    def _leave(self, context: Any) -> None:
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)

    def _start(self, context: Any) -> Job:
        return Job(interpreter_of(context), self._arguments(settings_of(context)))

    def _finish(self, context: Any) -> OperatorResult:
        try:
            self._use(context, self._job.answer())
        except (JobFailedError, RenderRefused, OSError, ValueError) as failed:
            return self._refuse(failed)
        finally:
            self._job.close()
        return _FINISHED

    def _refuse(self, failed: Exception) -> OperatorResult:
        self.report({"ERROR"}, str(failed))
        return _CANCELLED

    def _arguments(self, settings: Any) -> list[str]:
        raise NotImplementedError

    def _use(self, context: Any, answer: dict[str, Any]) -> None:
        raise NotImplementedError


class ShowRig(_CommandOperator, bpy.types.Operator):  # type: ignore[misc]
    """Put the rig's camera, projector and item into a scene of their own, with the fringes on show."""

    bl_idname = "fpplab.show_rig"
    bl_label = "Show Rig"

    def _arguments(self, settings: Any) -> list[str]:
        step = ["--step", str(settings.step)]
        return ["twin", "describe", *_arrangement(settings), *step, "--out", "{folder}/preview.npz"]

    def _use(self, context: Any, answer: dict[str, Any]) -> None:
        _show(answer)


class TakePicture(bpy.types.Operator):  # type: ignore[misc]
    """Render what the twin's camera sees, in grey levels, without noise."""

    bl_idname = "fpplab.take_picture"
    bl_label = "Take Picture"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return shown_preview() is not None and data.rig_scene() is not None

    def execute(self, context: Any) -> OperatorResult:
        """Render, and show the picture as an image; save it where the panel names a file."""
        preview, blender_scene = shown_preview(), data.rig_scene()
        assert preview is not None
        data.remove(data.PICTURE)
        with data.tag_new_data(data.PICTURE):
            clouds = [
                cloud
                for cloud in blender_scene.objects
                if cloud.get(data.TAG) == data.CLOUD and not cloud.hide_render
            ]
            for cloud in clouds:
                cloud.hide_render = True
            try:
                levels = take_picture(blender_scene, preview)
            finally:
                for cloud in clouds:
                    cloud.hide_render = False
            path = bpy.path.abspath(settings_of(context).picture)
            try:
                make_image(levels / preview.grey_scale.full_scale, path)
            except RuntimeError as failed:
                self.report({"ERROR"}, f"{path}: cannot be written ({failed})")
                return _CANCELLED
        return _FINISHED


class RecordScan(_CommandOperator, bpy.types.Operator):  # type: ignore[misc]
    """Measure the item on the simulation, and leave the session with its cloud."""

    bl_idname = "fpplab.record_scan"
    bl_label = "Record Scan"

    def _arguments(self, settings: Any) -> list[str]:
        session = _needed(settings.session, "a folder for the session")
        return ["twin", "record", *_arrangement(settings), "--out", session]

    def _use(self, context: Any, answer: dict[str, Any]) -> None:
        settings_of(context).cloud = answer["cloud"]
        self.report({"INFO"}, f"{answer['points']} points from {answer['images']} images")


class ImportErrors(_CommandOperator, bpy.types.Operator):  # type: ignore[misc]
    """Add measured points to the scene, coloured by their distance from the true shape."""

    bl_idname = "fpplab.import_errors"
    bl_label = "Import Cloud with Errors"

    def _arguments(self, settings: Any) -> list[str]:
        cloud = _needed(settings.cloud, "a cloud")
        truth = _needed(settings.truth, "the mesh of the true shape")
        align = ["--align"] if settings.align else []
        return ["compare", cloud, truth, *align, "--out", "{folder}/errors.ply"]

    def _use(self, context: Any, answer: dict[str, Any]) -> None:
        data.enter_rig_scene()
        data.remove(data.CLOUD)
        with data.tag_new_data(data.CLOUD):
            import_cloud(str(self._job.folder / "errors.ply"))
        self.report({"INFO"}, f"{answer['surface_rms_um']:.1f} µm RMS from the true shape")


class FitTwin(_CommandOperator, bpy.types.Operator):  # type: ignore[misc]
    """Match the rig's twin to a bench by the bench's recordings, and make it the panel's rig."""

    bl_idname = "fpplab.fit_twin"
    bl_label = "Fit Twin"

    def _arguments(self, settings: Any) -> list[str]:
        reference = _needed(settings.reference, "the folder of the bench's recordings")
        matched = _needed(settings.matched, "a folder for the matched twin")
        paths = ["--twin", _path(settings.rig), "--reference", reference, "--out", matched]
        return ["match", *paths, "--epochs", str(settings.epochs)]

    def _use(self, context: Any, answer: dict[str, Any]) -> None:
        settings_of(context).rig = answer["rig"]
        self.report({"INFO"}, f"matched: SSIM {answer['ssim']:.3f}, ε_d {answer['epsilon_d_px']:.3f} px")


class RemoveRig(bpy.types.Operator):  # type: ignore[misc]
    """Remove everything that the extension has added to the file."""

    bl_idname = "fpplab.remove_rig"
    bl_label = "Remove Rig"

    def execute(self, context: Any) -> OperatorResult:
        data.remove_all()
        forget_shown()
        return _FINISHED


OPERATORS = (ShowRig, TakePicture, RecordScan, ImportErrors, FitTwin, RemoveRig)  # all of them


def _show(answer: dict[str, Any]) -> None:
    preview = read_preview(answer["preview"])
    scene = data.enter_rig_scene()
    data.remove(data.RIG)
    with data.tag_new_data(data.RIG):
        show_preview(scene, preview)
    remember(preview, answer)


def _arrangement(settings: Any) -> list[str]:
    """Options of `fpplab twin` for what the panel says."""
    item = ["--item", settings.item] if settings.item else []
    baseline = ["--baseline", f"{settings.baseline:.6g}"] if settings.baseline else []
    fringes = [
        "--axis",
        settings.axis,
        "--stripes",
        f"{settings.stripes:.9g}",
        "--steps",
        str(settings.steps),
    ]
    exposure = ["--exposure", f"{1e-3 * settings.exposure:.6g}"]
    return ["--rig", _path(settings.rig), *item, "--pose", str(settings.pose), *baseline, *fringes, *exposure]


def _path(text: str) -> str:
    """A path as the operator wrote it, with Blender's `//` for the folder of the open file resolved."""
    return str(bpy.path.abspath(text))


def _needed(text: str, what: str) -> str:
    if not text:
        raise JobFailedError(f"name {what} in the panel")
    return str(Path(_path(text)))
