"""How a twin of real captures is judged: by the mean of its images, and by the mean square of its errors."""

import pytest

from benchmarks.real_captures import LeftOutPose, twin_figures


def test_poses_that_were_left_out_are_summed_up() -> None:
    poses = [
        LeftOutPose("a", 0.9, 0.96, 0.004, real_px=(0.3, 0.1), twin_px=(0.3, 0.2)),
        LeftOutPose("b", 0.8, 0.98, -0.02, real_px=(0.4, 0.1), twin_px=(0.4, 0.1)),
    ]
    figures = {result.name: result for result in twin_figures(poses)}
    assert figures["real_ssim_whole"].value == pytest.approx(0.85)
    assert figures["real_ssim_board"].value == pytest.approx(0.97)
    assert figures["real_epsilon_d"].value == pytest.approx(0.02), "the greatest, whatever its sign"
    assert figures["real_left_out_error_camera_in_twin"].value == pytest.approx(0.0)
    assert figures["real_left_out_error_projector_in_twin"].value == pytest.approx(2.5**0.5 - 1.0)
