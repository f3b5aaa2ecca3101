"""The table of direct light on a flat, matt item by formula: as Blender renders it, but much faster.

A ray from a point of the lens meets the item's plane z = 0 in its own frame. With the lamp at height h above
that plane, a point at depth z before the lamp and distance r from it has `cos(incidence) = h/r` and
`cos(axis) = z/r`, and white light falls on it with

    E = (D/r)² cos(incidence) / cos(axis)³ = D² h / z³

for irradiance 1 on a facing surface at distance D (`sim.blender.projector` has the law of the lamp). Rays,
lens points and their rotation are those of `sim/blender/camera.osl`, in double precision.

Where Blender's rays sample points, ours can sample spots: each of the K samples of a pixel then represents
a K-th of the blur by pixel and lens, and the print is blurred by as much beforehand. On a plane only the sum
of a place in the pixel and of a point of the lens matters, so both are correlated instead of independent, as
far as the variance of the sum allows. Few samples then reproduce an edge as very many would, equally in all
pixels.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats, PixelIndices
from fpplab.core.geometry import Pinhole, RigidTransform
from sim.light.blurred_pictures import BlurredPictureCache, BlurredPictures, unblurred_picture
from sim.light.rays import distorted, lens_turn, on_lens, slopes_at
from sim.light.table import Irradiance, LightTable, MotionTable, circle_level
from sim.scene import Paint, RenderScene, SubpixelView

_cache = BlurredPictureCache()


def can_compute(scene: RenderScene) -> bool:
    """Return whether a scene is one rectangle in its plane z = 0, of matt paint without relief."""
    if len(scene.surfaces) != 1:
        return False
    surface = scene.surfaces[0]
    flat = len(surface.vertices) == 4 and not surface.vertices[:, 2].any()
    return flat and surface.paint == Paint(surface.paint.reflectance, ink=surface.paint.ink)


def computed(
    scene: RenderScene, views: list[SubpixelView], spots: bool = False, pixels: PixelIndices | None = None
) -> LightTable:
    """Compute the table that a survey of this scene gives, see `LightTable.of`."""
    return _trace_tables(scene, views, spots, pixels, moving=False).table


def computed_motion(
    scene: RenderScene, views: list[SubpixelView], pixels: PixelIndices | None = None
) -> MotionTable:
    """Compute the same table by spots, and how it changes as the item moves."""
    return _trace_tables(scene, views, True, pixels, moving=True)


def _trace_tables(
    scene: RenderScene, views: list[SubpixelView], spots: bool, pixels: PixelIndices | None, moving: bool
) -> MotionTable:
    """Trace a scene; derivatives are left empty unless it is `moving`."""
    camera, lamp, surface = scene.camera, scene.lamp, scene.surfaces[0]
    width, height = camera.size
    pose = _transform(surface.T_camera_item)
    lamp_pose = _transform(lamp.T_camera_projector)
    left, top, right, bottom = scene.window
    rows, columns = np.mgrid[top:bottom, left:right] if pixels is None else pixels
    samples = np.zeros((len(views), rows.size, 4), np.float32)
    albedo = np.zeros(rows.size, np.float32)
    kept = rows.size if moving else 0
    slopes = np.zeros((len(views), kept, 2), np.float32)
    albedo_slopes = np.zeros((kept, 2), np.float32)
    motion = np.zeros((kept, 5, 3), np.float32)
    reach = Pinhole(camera.size, camera.matrix, camera.distortion).reach
    radius = 0.5 * scene.aperture.diameter_mm
    spots = spots and surface.picture is not None  # a uniform surface has nothing to blur
    blurred = (
        _board_picture_blurred_by_defocus(scene, len(views)) if spots else unblurred_picture(surface.picture)
    )
    shifts = np.array([view.shift for view in views])
    lens = _correlated_lens(shifts) if spots else np.array([view.lens for view in views])
    if spots and len(views) > 1:
        shifts *= np.sqrt(_places_share(len(views)) / (1.0 - 1.0 / len(views)))
    _trace(
        columns=columns.ravel(),
        rows=rows.ravel(),
        height=height,
        views=np.column_stack([shifts, lens]).astype(np.float64),
        variance=_joint_variance(shifts, lens),
        matrix=camera.matrix,
        lens=camera.distortion,
        reach=reach,
        radius=radius,
        focus=scene.aperture.focus_mm,
        T_item_camera=pose.inverse().matrix[:3],
        T_projector_item=(lamp_pose.inverse() @ pose).matrix[:3],
        lamp=pose.inverse().apply(lamp_pose.translation),
        cosine=np.cos(lamp.half_angle),
        distance=lamp.distance_mm,
        lamp_lens=lamp.optics.distortion,
        to_texel=lamp.affine @ lamp.optics.matrix,
        circle_scale=lamp.texels_per_slope * lamp.aperture.diameter_mm,
        inverse_focus=1.0 / lamp.aperture.focus_mm,
        squares=np.array(lamp.circles, np.float64) ** 2,
        low=surface.vertices[0, :2],
        high=surface.vertices[2, :2],
        paint=np.array([surface.paint.ink, surface.paint.reflectance - surface.paint.ink]),
        variances=blurred.variances_mm2,
        pictures=blurred.pictures,
        across=blurred.across,
        down=blurred.down,
        rim=blurred.rim,
        samples=samples,
        albedo=albedo,
        slopes=slopes,
        albedo_slopes=albedo_slopes,
        motion=motion,
    )
    if pixels is not None:
        table = LightTable(samples[:, None], albedo[None])
    else:
        whole = np.zeros((height, width), np.float32)
        whole[top:bottom, left:right] = albedo.reshape(rows.shape)
        table = LightTable(samples.reshape(len(views), *rows.shape, 4), whole, (left, top))
    return MotionTable(table, slopes, albedo_slopes, motion)


def _board_picture_blurred_by_defocus(scene: RenderScene, aperture_samples: int) -> BlurredPictures:
    """Blur the print for all sizes of spots on it."""
    surface, aperture, camera = scene.surfaces[0], scene.aperture, scene.camera
    assert surface.picture is not None
    low, high = surface.vertices[0, :2], surface.vertices[2, :2]
    pose = _transform(surface.T_camera_item)
    places = np.linspace(low, high, 5)
    on_print = np.stack([*np.meshgrid(*places.T), np.zeros((5, 5))], axis=-1)
    points = pose.apply(on_print.reshape(-1, 3))
    spread = [
        _spot_variance_mm2(
            float(point[2]),
            float(abs(pose.rotation[:, 2] @ point) / point[2]),
            1.0 / (camera.matrix[0, 0] * camera.matrix[1, 1]),
            0.5 * aperture.diameter_mm,
            aperture.focus_mm,
            aperture_samples,
        )
        for point in points
    ]
    x, y = np.array(surface.picture.shape[::-1]) / (high - low)
    return _cache.blurred(surface.picture, (float(x), float(y)), min(spread), max(spread))


def _correlated_lens(shifts: Floats) -> Floats:
    """Map places in a pixel to points (K, 2) of the unit disc, y up; squares become circles."""
    u, v = 2 * shifts.T
    wide = np.abs(u) >= np.abs(v)
    radius = np.where(wide, np.abs(u), np.abs(v))
    azimuth = np.where(wide, v, u) / np.maximum(radius, 1e-12) * np.pi / 4
    along, across = radius * np.cos(azimuth), radius * np.sin(azimuth)
    x = np.where(wide, np.sign(u) * along, across)
    y = np.where(wide, across, np.sign(v) * along)
    return np.stack([x, -y], axis=-1)


def _joint_variance(shifts: Floats, lens: Floats) -> tuple[float, float]:
    """Variance of the points of the lens along u, and their covariance with the places in the pixel."""
    return float(np.mean(lens**2)), float(np.mean(shifts[:, 0] * lens[:, 0]))


@numba.njit(cache=True, inline="always")
def _places_share(samples: int) -> float:
    """Share of the blur's variance that the samples' places represent; the rest is the spots' own."""
    # The standard deviation of a spot is half the distance between spots: narrower ones would leave gaps, so
    # that an edge would jump from spot to spot.
    return (samples - 1.0) / (samples + 2.0)


@numba.njit(cache=True, inline="always")
def _lens_scale_with_blur(circle: float, samples: int, variance: tuple[float, float]) -> float:
    """Scale of the lens points for which pixel and lens blur as much as if they were independent."""
    # circle: radius of the circle of confusion in px, negative where the blur is inverted.
    own, common = variance
    missing = _places_share(samples) * circle * circle / 4.0
    span = (np.sqrt(common * common + own * missing) - common) / own
    return float(span / circle)


@numba.njit(cache=True, inline="always")
def _spot_variance_mm2(
    depth: float, fall: float, pixel: float, radius: float, focus: float, samples: int
) -> float:
    """Variance in mm² of the spot of one sample of a pixel, on a plane that rays meet at `depth`."""
    # fall: component of the ray with z = 1 along the plane's normal. pixel: its area in slopes. A square of
    # side 1 has the variance 1/12, a disc of radius 1 has 1/4; a solid angle is wider on a tilted plane.
    lens = radius * (1.0 / depth - 1.0 / focus)
    return float((1.0 - _places_share(samples)) * (pixel / 12.0 + lens * lens / 4.0) * depth * depth / fall)


def _transform(matrix: Floats) -> RigidTransform:
    return RigidTransform(matrix[:3, :3], matrix[:3, 3])


@kernel(parallel=True, error_model="numpy")
def _trace(
    columns: NDArray[np.intp],
    rows: NDArray[np.intp],
    height: int,
    views: Floats,
    variance: tuple[float, float],
    matrix: Floats,
    lens: Floats,
    reach: float,
    radius: float,
    focus: float,
    T_item_camera: Floats,
    T_projector_item: Floats,
    lamp: Floats,
    cosine: float,
    distance: float,
    lamp_lens: Floats,
    to_texel: Floats,
    circle_scale: float,
    inverse_focus: float,
    squares: Floats,
    low: Floats,
    high: Floats,
    paint: Floats,
    variances: Floats,
    pictures: Irradiance,
    across: Irradiance,
    down: Irradiance,
    rim: tuple[int, int],
    samples: Irradiance,
    albedo: Irradiance,
    slopes: Irradiance,
    albedo_slopes: Irradiance,
    motion: Irradiance,
) -> None:
    """Trace all samples of pixels and fill in `samples` (K, P, 4) and `albedo` (P,)."""
    # columns, rows: (P,) of an image of that height. views: (K, 4) shift u, v and lens x, y, with their joint
    # `variance`. lamp: in the item's frame. low, high: corners of the item. paint: reflectance of the print,
    # and by how much more the ground reflects. variances (mm²), pictures, across, down, rim: as in
    # `BlurredPictures`; without spots there is one variance and no rim. slopes (K, P, 2), albedo_slopes (P,
    # 2), motion (P, 5, 3): as in `MotionTable`, all of them without pixels where they are not wanted.
    R, t = T_item_camera[:, :3], T_item_camera[:, 3]
    P, p = T_projector_item[:, :3], T_projector_item[:, 3]
    share = 1.0 / len(views)
    pixel = 1.0 / (matrix[0, 0] * matrix[1, 1])
    moving = len(motion) > 0
    wide, tall = high[0] - low[0], high[1] - low[1]
    beyond_x = wide * rim[0] / (pictures.shape[2] - 2 * rim[0])
    beyond_y = tall * rim[1] / (pictures.shape[1] - 2 * rim[1])
    for i in numba.prange(len(rows)):
        u, v = columns[i], rows[i]
        sine, turned = 0.0, 1.0
        if radius > 0 and len(variances) == 1:
            sine, turned = lens_turn(u, v, height)
        reached = radius
        if radius > 0 and len(variances) > 1 and len(views) > 1:
            x, y = (u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1]
            middle = -t[2] / (R[2, 0] * x + R[2, 1] * y + R[2, 2])
            circle = radius * (1.0 / middle - 1.0 / focus) / np.sqrt(pixel)
            if circle != 0:
                reached = radius * _lens_scale_with_blur(circle, len(views), variance)
        x0, y0 = slopes_at(u, v, matrix, lens, reach)
        middle_x, middle_y, xx, xy, yy = distorted(x0, y0, lens)
        determinant = xx * yy - xy * xy
        if moving:
            _fill_motion(
                x=x0,
                y=y0,
                R=R,
                t=t,
                P=P,
                p=p,
                lamp_height=lamp[2],
                lamp_lens=lamp_lens,
                to_texel=to_texel,
                out=motion[i],
            )
        for k in range(len(views)):
            if determinant > 0.1:  # the distortion is straight over one pixel (chosen)
                along, upright = views[k, 0] / matrix[0, 0], views[k, 1] / matrix[1, 1]
                x = x0 + (yy * along - xy * upright) / determinant
                y = y0 + (xx * upright - xy * along) / determinant
                bent_x, bent_y, _, _, _ = distorted(x, y, lens)
                off_x, off_y = middle_x + along - bent_x, middle_y + upright - bent_y
                x += (yy * off_x - xy * off_y) / determinant
                y += (xx * off_y - xy * off_x) / determinant
            else:
                x, y = slopes_at(u + views[k, 0], v + views[k, 1], matrix, lens, reach)
            ox, oy = on_lens(reached, views[k, 2], views[k, 3], sine, turned)
            dx, dy, dz = x - ox / focus, y - oy / focus, 1.0
            start = R[2, 0] * ox + R[2, 1] * oy + t[2]
            fall = -(R[2, 0] * dx + R[2, 1] * dy + R[2, 2] * dz)
            length = start / fall
            if not length > 0:
                continue
            cx, cy = ox + length * dx, oy + length * dy
            ix = R[0, 0] * cx + R[0, 1] * cy + R[0, 2] * length + t[0]
            iy = R[1, 0] * cx + R[1, 1] * cy + R[1, 2] * length + t[1]
            if not (low[0] - beyond_x <= ix <= high[0] + beyond_x):
                continue
            if not (low[1] - beyond_y <= iy <= high[1] + beyond_y):
                continue
            sx, sy = (ix - low[0]) / wide, (iy - low[1]) / tall
            if len(variances) == 1:
                grey, by_x, by_y = _reflected_light(pictures[0], across[0], down[0], rim, sx, sy, paint)
            else:
                spot = _spot_variance_mm2(length, abs(fall), pixel, radius, focus, len(views))
                size, more = _between_sizes(spot, variances)
                near, near_x, near_y = _reflected_light(
                    pictures[size], across[size], down[size], rim, sx, sy, paint
                )
                size += 1
                far, far_x, far_y = _reflected_light(
                    pictures[size], across[size], down[size], rim, sx, sy, paint
                )
                grey = near + more * (far - near)
                by_x, by_y = near_x + more * (far_x - near_x), near_y + more * (far_y - near_y)
            albedo[i] += share * grey
            if moving:
                albedo_slopes[i, 0] += share * by_x / wide
                albedo_slopes[i, 1] += share * by_y / tall
            qx = P[0, 0] * ix + P[0, 1] * iy + p[0]
            qy = P[1, 0] * ix + P[1, 1] * iy + p[1]
            qz = P[2, 0] * ix + P[2, 1] * iy + p[2]
            away = np.sqrt(qx * qx + qy * qy + qz * qz)
            if start * lamp[2] <= 0 or qz <= cosine * away or grey <= 0:
                continue
            xd, yd, _, _, _ = distorted(qx / qz, qy / qz, lamp_lens)
            sample = samples[k, i]
            sample[0] = to_texel[0, 0] * xd + to_texel[0, 1] * yd + to_texel[0, 2]
            sample[1] = to_texel[1, 0] * xd + to_texel[1, 1] * yd + to_texel[1, 2]
            sample[2] = circle_level(qz, circle_scale, inverse_focus, squares)
            light = distance * distance * abs(lamp[2]) / (qz * qz * qz)
            sample[3] = grey * light
            if moving:
                slopes[k, i, 0], slopes[k, i, 1] = light * by_x / wide, light * by_y / tall


@kernel(error_model="numpy")
def _fill_motion(
    x: float,
    y: float,
    R: Floats,
    t: Floats,
    P: Floats,
    p: Floats,
    lamp_height: float,
    lamp_lens: Floats,
    to_texel: Floats,
    out: Irradiance,
) -> None:
    """Differentiate what the ray with slopes x, y meets by the item's place: (5, 3) of `MotionTable`."""
    # R, t: from camera to item. P, p: from item to projector.
    fall = R[2, 0] * x + R[2, 1] * y + R[2, 2]
    depth = -t[2] / fall
    ix = (R[0, 0] * x + R[0, 1] * y + R[0, 2]) * depth + t[0]
    iy = (R[1, 0] * x + R[1, 1] * y + R[1, 2]) * depth + t[1]
    qx = P[0, 0] * ix + P[0, 1] * iy + p[0]
    qy = P[1, 0] * ix + P[1, 1] * iy + p[1]
    qz = P[2, 0] * ix + P[2, 1] * iy + p[2]
    sx, sy = qx / qz, qy / qz
    _, _, xx, xy, yy = distorted(sx, sy, lamp_lens)
    # A displacement along the normal moves the point along the ray; by so much in the item's frame, per mm.
    rx = (R[0, 0] * x + R[0, 1] * y + R[0, 2]) / fall
    ry = (R[1, 0] * x + R[1, 1] * y + R[1, 2]) / fall
    # and in the projector's
    fx = P[0, 0] * rx + P[0, 1] * ry + P[0, 2]
    fy = P[1, 0] * rx + P[1, 1] * ry + P[1, 2]
    fz = P[2, 0] * rx + P[2, 1] * ry + P[2, 2]
    by_x, by_y = (fx - sx * fz) / qz, (fy - sy * fz) / qz
    bent_x, bent_y = xx * by_x + xy * by_y, xy * by_x + yy * by_y
    for axis in range(3):
        normal = R[2, axis]
        out[0, axis] = -normal / lamp_height - 3.0 * fz / qz * normal
        out[1, axis] = rx * normal - R[0, axis]
        out[2, axis] = ry * normal - R[1, axis]
        out[3, axis] = (to_texel[0, 0] * bent_x + to_texel[0, 1] * bent_y) * normal
        out[4, axis] = (to_texel[1, 0] * bent_x + to_texel[1, 1] * bent_y) * normal


@numba.njit(cache=True, inline="always")
def _between_sizes(spot: float, variances: Floats) -> tuple[int, float]:
    """Index of the next smaller size, and the fraction 0 to 1 of the way to the next larger one."""
    size = 0
    while size < len(variances) - 2 and spot > variances[size + 1]:
        size += 1
    share = (spot - variances[size]) / (variances[size + 1] - variances[size])
    return size, min(max(share, 0.0), 1.0)


@kernel(error_model="numpy")  # inlined three times it takes seconds more to compile
def _reflected_light(
    picture: Irradiance,
    across: Irradiance,
    down: Irradiance,
    rim: tuple[int, int],
    x: float,
    y: float,
    paint: Floats,
) -> tuple[float, float, float]:
    """Reflectance at x, y, 0 to 1 over the whole of the item, and its derivatives by them."""
    # Between the centres of pixels everything is linear.
    rows, columns = picture.shape
    wide, tall = columns - 2 * rim[0], rows - 2 * rim[1]
    u, v = x * wide - 0.5, y * tall - 0.5
    # the rim is added to whole numbers, so that its width changes nothing
    i, j = int(np.floor(u)), int(np.floor(v))
    fu, fv = u - i, v - j
    i, j = i + rim[0], j + rim[1]
    left, right = min(max(i, 0), columns - 1), min(max(i + 1, 0), columns - 1)
    above, below = min(max(j, 0), rows - 1), min(max(j + 1, 0), rows - 1)
    a, b, c, d = picture[above, left], picture[above, right], picture[below, left], picture[below, right]
    upper, lower = a * (1 - fu) + b * fu, c * (1 - fu) + d * fu
    along, upright = across[left] * (1 - fu) + across[right] * fu, down[above] * (1 - fv) + down[below] * fv
    ink, more = paint[0], paint[1]
    grey = ink * along * upright + more * (upper * (1 - fv) + lower * fv)
    by_x = ink * (across[right] - across[left]) * upright + more * ((b - a) * (1 - fv) + (d - c) * fv)
    by_y = ink * along * (down[below] - down[above]) + more * (lower - upper)
    return float(grey), float(by_x * wide), float(by_y * tall)
