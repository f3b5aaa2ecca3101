"""One file or folder of every kind: fpplab's own, those of other programs, damaged ones, and none at all."""

import json
import shutil
import zipfile
from pathlib import Path

import cv2
import numpy as np
import trimesh
from PIL import Image as Pillow
from scipy.io import savemat

from fpplab import Calibration, Cloud, save_cloud
from fpplab.calibration.variants import export_calibration
from fpplab.clouds.exchange import export_cloud
from tests.support.commands import ROOT
from tests.support.recorded import record

CONFIGS = {
    "calibration": "calibration_matched",
    "dataset": "dataset_demo",
    "plan": "plan_paper",
    "rig": "rig_demo_quick",
    "standard": "standard_demo",
    "study": "study_baseline",
    "target": "target_paper",
    "world": "world_demo",
}
KALIBR = """\
cam0:
  camera_model: pinhole
  distortion_coeffs: [0, 0, 0, 0]
  distortion_model: radtan
  intrinsics: [1000, 1000, 320, 240]
  resolution: [640, 480]
cam1:
  T_cn_cnm1: [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
  camera_model: pinhole
  distortion_coeffs: [0, 0, 0, 0]
  distortion_model: radtan
  intrinsics: [1000, 1000, 320, 240]
  resolution: [640, 480]
"""
MRCAL = """\
{
    'lensmodel': 'LENSMODEL_OPENCV4',
    'intrinsics': [1000, 1000, 320, 240, 0, 0, 0, 0],
    'imagersize': [640, 480],
    'extrinsics': [0, 0, 0, 0, 0, 0],
}
"""
PAGE = "<!DOCTYPE html>\n<html><head><title>404</title></head><body>Not found</body></html>\n"
REPORT = (
    '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta name="generator" content="fpplab">\n</head>\n</html>\n'
)
TEXTS = {
    "answer.json": json.dumps({"verdict": "good", "findings": [], "points": 3}),
    "empty.txt": "",
    "kalibr.yaml": KALIBR,
    "limits.yaml": "verdict: {}\n",
    "model.cameramodel": MRCAL,
    "page.html": PAGE,
    "page.yaml": PAGE,
    "points.csv": "pose,id,camera_u,camera_v,projector_u,projector_v\n1,0,10,10,10,10\n",
    "prose.txt": "Dear colleague,\nplease find the scan attached.\n",
    "report.html": REPORT,
    "response.yaml": "levels: [0.0, 1.0]\nmeasured: []\n",
}
CUT = ("calibration.yaml", "cloud.ply", "opencv.yml", "part.stl", "rig.yaml", "video.avi", "image.png")


def make_files(folder: Path) -> list[str]:
    """Write one of each kind into an empty folder; their names."""
    for name, config in CONFIGS.items():
        shutil.copy(ROOT / "configs" / f"{config}.yaml", folder / f"{name}.yaml")
    shutil.copy(folder / "world.yaml", folder / "world_demo.yaml")
    for name, text in TEXTS.items():
        (folder / name).write_text(text, encoding="utf-8")
    for path in ("my_session", "my_poses/a", "my_poses/b"):
        record(folder / path)
    shutil.copy(folder / "my_session/journal.jsonl", folder / "frames.jsonl")
    (folder / "my_folder").mkdir()
    _write_clouds(folder)
    _write_calibrations(folder)
    _write_pictures(folder)
    (folder / "document.pdf").write_bytes(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n1 0 obj\n<<>>\nendobj\n")
    with zipfile.ZipFile(folder / "archive.zip", "w") as archive:
        archive.writestr("a.txt", "hello")
    noise = np.random.default_rng(1).integers(0, 256, 5000, dtype=np.uint8)
    (folder / "noise.bin").write_bytes(noise.tobytes())
    for name in CUT:
        content = (folder / name).read_bytes()
        (folder / f"cut_{name}").write_bytes(content[: len(content) // 3])
    return sorted(path.name for path in folder.iterdir() if path.name != "world_demo.yaml")


def _write_clouds(folder: Path) -> None:
    rng = np.random.default_rng(2)
    points = np.stack([*rng.uniform(-20, 20, (2, 200)), rng.uniform(400, 405, 200)], axis=1)
    cloud = Cloud(points.astype(np.float32))
    for suffix in ("ply", "xyz", "npz"):
        save_cloud(cloud, folder / f"cloud.{suffix}")
    for suffix in ("csv", "e57", "las"):
        export_cloud(cloud, folder / f"cloud.{suffix}")
    shutil.copy(folder / "cloud.xyz", folder / "cloud.txt")
    box = trimesh.creation.box((40, 40, 5)).apply_translation((0, 0, 402.5))
    for suffix in ("stl", "obj", "off", "3mf"):
        box.export(folder / f"part.{suffix}")
    box.export(folder / "part_mesh.ply")
    (folder / "part.step").write_text("ISO-10303-21;\nHEADER;\n", encoding="ascii")


def _write_calibrations(folder: Path) -> None:
    calibration = Calibration.load(folder / "calibration.yaml")
    layouts = {
        "opencv.yml": "opencv",
        "opencv.xml": "opencv",
        "opencv.json": "opencv",
        "matlab.mat": "matlab",
    }
    for name, layout in {**layouts, "slstudio.xml": "slstudio", "ros": "ros"}.items():
        export_calibration(calibration, folder / name, layout)
    shutil.copy(folder / "ros/camera.yaml", folder / "ros_camera.yaml")
    savemat(folder / "matlab_4.mat", {"M1": np.eye(3)}, format="4")
    np.savez(folder / "tutorial.npz", mtx=np.eye(3), dist=np.zeros((1, 5)), rvecs=np.zeros((3, 3, 1)))
    np.savez(folder / "decoded.npz", u=np.zeros((4, 4)), v=np.zeros((4, 4)))


def _write_pictures(folder: Path) -> None:
    levels = np.random.default_rng(3).integers(0, 255, (48, 64), dtype=np.uint8)
    for suffix in ("png", "jpg", "tif", "bmp", "pgm"):
        Pillow.fromarray(levels).save(folder / f"image.{suffix}")
    np.save(folder / "image.npy", levels)
    (folder / "my_images").mkdir()
    for index in range(4):
        Pillow.fromarray(levels + np.uint8(index)).save(folder / f"my_images/{index:02d}.png")
    writer = cv2.VideoWriter(
        str(folder / "video.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (levels.shape[1], levels.shape[0])
    )
    for _ in range(4):
        writer.write(np.dstack([levels] * 3))
    writer.release()
