"""The projector's lattice in the twin beside exact optics: ripple of the phase, a flat card, look-up time.

Exact optics are written out here once more, apart from the twin: square mirrors under a Gaussian point
spread, summed mirror by mirror.
"""

import time
from statistics import median

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from benchmarks import Result, below
from fpplab.core.config import find_config
from fpplab.core.conventions import TWO_PI, Floats, Lattice, mirror_centres
from sim.build import SceneState, build_scene
from sim.items import item_poses
from sim.light import Light
from sim.light.table import LightTable
from sim.texture import MirrorTexture, PatternTextures
from sim.worker import Blender
from sim.world import World

BLURS, STRIPES = (0.3, 0.4, 0.5, 0.6, 0.69), (64.0, 167.2, 228.0)
COLUMNS, ROWS, STEPS = 912, 120, 12
WORLDS = ("demo", "hidden")
RIPPLE_SHARE, RIPPLE_PX, CARD_UM, LOOK_UP = 0.1, 2e-4, 0.5, 1.5
PLACES = 20_000
REPEATS = 7


def lattice_figures() -> list[Result]:
    """Measure the lattice's ripple, cards of noise-free images, and look-ups."""
    ripples = [
        _ripple(blur, stripes, lattice) for lattice in Lattice for blur in BLURS for stripes in STRIPES
    ]
    return [*ripples, *(_card(name) for name in WORLDS), *_times()]


def _ripple(blur: float, stripes: float, lattice: Lattice) -> Result:
    texture = MirrorTexture((COLUMNS, ROWS), lattice, blur)
    random = np.random.default_rng([int(1000 * blur), int(10 * stripes)])
    u, v = random.uniform(400, 500, PLACES), random.uniform(50, 70, PLACES)
    places = np.stack([u, v, np.ones_like(u)], axis=-1) @ texture.affine.T
    levels = _fringes(stripes, (COLUMNS, ROWS), lattice)
    samples = np.zeros((1, 1, PLACES, 4), np.float32)
    samples[0, 0, :, :2], samples[..., 3] = places, 1.0
    table = LightTable(samples, np.zeros((1, PLACES), np.float32))
    twin = table.look_up(texture.textures(levels, part=table.part(texture.shape)))[:, 0]
    exact = _exact(places, texture, levels, blur)
    found, true = (
        _spread_px(_phase(seen) - TWO_PI * u * stripes / COLUMNS, stripes) for seen in (twin, exact)
    )
    off = min(abs(found - true) / (RIPPLE_SHARE * true), max(found, true) / RIPPLE_PX)
    return Result(f"ripple_{lattice.value}_{stripes:g}_{blur:g}", found, "px", true, 1 / max(off, 1e-3))


def _fringes(stripes: float, size: tuple[int, int], lattice: Lattice) -> NDArray[np.float32]:
    """Levels (STEPS, rows, columns) of unrounded fringes along x."""
    u, _ = mirror_centres(size, lattice)
    steps = np.arange(STEPS)[:, None, None] / STEPS
    levels = 0.5 + 0.5 * np.cos(TWO_PI * (u * stripes / size[0] - steps))
    return np.asarray(levels, np.float32)


def _exact(places: Floats, texture: MirrorTexture, levels: NDArray[np.float32], blur: float) -> Floats:
    """Light (STEPS, n) at texture places (n, 2), by the sum over all mirrors within 5 sigma."""
    sharp = MirrorTexture(texture.size, texture.lattice, 0.0)
    offset = texture.affine[:, 2] - sharp.affine[:, 2]
    texels = np.stack([sharp.filtered(level)[0] for level in levels], axis=-1).astype(np.float64)
    places = places - offset
    near = np.rint(places).astype(int)
    total = np.zeros((len(places), len(levels)))
    reach = int(np.ceil(5 * blur + 0.5))
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            mirror = near + [dx, dy]
            across, down = _edge(places - mirror, blur).T
            total += (across * down)[:, None] * texels[mirror[:, 1], mirror[:, 0]]
    return np.asarray(total.T)


def _edge(offset: Floats, blur: float) -> Floats:
    return (
        np.asarray(erf((offset + 0.5) / (np.sqrt(2) * blur)) - erf((offset - 0.5) / (np.sqrt(2) * blur))) / 2
    )


def _phase(seen: NDArray[np.float32] | Floats) -> Floats:
    """Phase of STEPS equal steps."""
    turned = np.tensordot(np.exp(2j * np.pi * np.arange(STEPS) / STEPS), seen.astype(np.float64), axes=1)
    return np.asarray(np.angle(turned))


def _spread_px(error: Floats, stripes: float) -> float:
    wrapped = np.angle(np.exp(1j * error))
    return float(np.std(wrapped) * COLUMNS / stripes / TWO_PI)


def _card(name: str) -> Result:
    """Form of a flat card in the middle of the field, from noise-free images of the finest fringes."""
    world = World.load(find_config(f"world_{name}"))
    setup = SceneState("grey_card")
    blender = Blender(name)
    try:
        light = Light(world, blender)
        scene, texture = build_scene(world, setup)
        table = light.table(setup)
    finally:
        blender.close()
    levels = _fringes(max(STRIPES[:2]), world.projector.size, world.projector.lattice)
    seen = table.look_up(texture.textures(levels, scene.lamp.circles, table.part(texture.shape)))
    height, width = seen.shape[1:]
    window = np.s_[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3]
    phase = _phase(seen[(slice(None), *window)])
    v, u = np.mgrid[:height, :width][(slice(None), *window)].astype(np.float64)
    camera, projector, pose = world.camera_model(), world.projector_model(), setup.T_projector_camera(world)
    rays = np.concatenate([camera.normalise(np.stack([u, v], axis=-1)), np.ones((*u.shape, 1))], axis=-1)
    card = item_poses(world, "grey_card")[0]
    normal = card.rotation[:, 2]
    depth = (normal @ card.translation / (rays @ normal))[..., None]
    true, farther = (projector.project(pose.apply(rays * z))[..., 0] for z in (depth, depth + 1.0))
    period = world.projector.size[0] / max(STRIPES[:2])
    off = np.angle(np.exp(1j * (phase - TWO_PI * true / period))) * period / TWO_PI
    error = (off / (farther - true) * 1000).ravel()
    plane = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=-1)
    left = error - plane @ np.linalg.lstsq(plane, error, rcond=None)[0]
    return below(f"card_{name}", float(left.std()), "um", CARD_UM)


def _times() -> list[Result]:
    """Look-ups of 36 patterns in a megapixel beside linear interpolation between the same texels."""
    random = np.random.default_rng(7)
    v, u = np.mgrid[:1000, :1000]
    textures = PatternTextures(
        random.random((1, 600, 600, 36), np.float32),
        MirrorTexture((10, 10), Lattice.SQUARE, 0.6).weights((0.0,)),
    )
    results = []
    for views in (4, 9):
        samples = np.ones((views, *u.shape, 4), np.float32)
        samples[..., 0] = 100 + 0.35 * u + 0.1 * v + random.uniform(-0.2, 0.2, (views, 1, 1))
        samples[..., 1] = 200 - 0.1 * u + 0.35 * v + random.uniform(-0.2, 0.2, (views, 1, 1))
        samples[..., 2] = 0.0
        exact, linear = _look_up_times(samples, textures)
        allowed = linear * LOOK_UP
        results.append(Result(f"look_up_{views}_samples", exact * 1e3, "ms", allowed * 1e3, allowed / exact))
    return results


def _look_up_times(samples: NDArray[np.float32], textures: PatternTextures) -> tuple[float, float]:
    """Median times in s of our look-up and of linear interpolation, in turn."""
    table = LightTable(samples, np.zeros(samples.shape[1:3], np.float32))
    flat = samples.reshape(len(samples), -1, 4)
    out = np.empty((12, flat.shape[1]), np.float32)
    batches = [np.ascontiguousarray(textures.texels[0, ..., k : k + 12]) for k in (0, 12, 24)]
    times: list[list[float]] = [[], []]
    for _ in range(REPEATS + 1):
        start = time.perf_counter()
        table.look_up(textures)
        middle = time.perf_counter()
        for batch in batches:
            _linear(batch, flat, out)
        for of, took in zip(times, (middle - start, time.perf_counter() - middle), strict=True):
            of.append(took)
    exact, linear = (median(of[1:]) for of in times)  # the first compiles
    return exact, linear


@numba.njit(parallel=True, cache=True, fastmath={"contract", "reassoc", "nsz"})
def _linear(texels: NDArray[np.float32], samples: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Linear interpolation of texels (rows, columns, patterns), a dozen patterns at once: the baseline."""
    views, pixels, _ = samples.shape
    patterns = texels.shape[2]
    for p in numba.prange(pixels):
        total = np.zeros(patterns, np.float32)
        for k in range(views):
            x, y, shade = samples[k, p, 0], samples[k, p, 1], samples[k, p, 3]
            i, j = int(x), int(y)
            fx, fy = x - np.float32(i), y - np.float32(j)
            a, b = shade * (np.float32(1.0) - fx), shade * fx
            for q in range(patterns):
                upper = a * texels[j, i, q] + b * texels[j, i + 1, q]
                lower = a * texels[j + 1, i, q] + b * texels[j + 1, i + 1, q]
                total[q] += upper + fy * (lower - upper)
        for q in range(patterns):
            out[q, p] = total[q] / np.float32(views)
