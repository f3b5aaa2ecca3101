"""Which images are taken, and in which order."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image as Pillow

from fpplab.core.conventions import Image
from fpplab.core.errors import ConfigError, DataError, FppError
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.sessions.image_selection import ImageSelection as Chosen
from fpplab.sessions.image_selection import numbers_of
from fpplab.sessions.importing import import_images, read_images
from tests.support.recorded import image_of

SIZE = (64, 48)
PLAN = Plan(
    fringes=(
        Sinusoid(axis="x", stripes=1, steps=3, projector_size=SIZE),
        Sinusoid(axis="x", stripes=8, steps=4, projector_size=SIZE),
    )
)
IMAGES = [image_of(index) for index in range(7)]
STEPS = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (1, 3)]


def put(folder: Path, names: list[str], images: list[Image] = IMAGES) -> Path:
    for name, image in zip(names, images, strict=True):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Pillow.fromarray(image).save(folder / name)
    return folder


def taken(source: Chosen) -> None:
    """Both readers take the seven images in order."""
    images, bits = read_images(source)
    assert bits == 8
    np.testing.assert_array_equal(images, IMAGES)
    out = source.places[0].parent / "session" if source.places else Path(str(source.names)[1:]).parent / "s"
    session = import_images(source, PLAN, out)
    np.testing.assert_array_equal(session.stack(), IMAGES)


def refuses(source: Chosen, complaint: str, error: type[FppError] = DataError, **options: Any) -> None:
    out = source.places[0].parent / "refused"
    with pytest.raises(error, match=complaint):
        import_images(source, PLAN, out, **options)
    assert not out.exists()


@pytest.mark.parametrize("form", ["set{set}_step{step}.png", "s{set:02d}/{step:03d}.png", "{step} {set}.png"])
def test_names_with_set_and_step(tmp_path: Path, form: str) -> None:
    folder = put(tmp_path / "images", [form.format(set=s, step=n) for s, n in STEPS])
    put(folder, ["white.png"], [image_of(9)])
    taken(Chosen((folder,), form))


def test_sets_and_steps_that_count_from_one(tmp_path: Path) -> None:
    form = "set{set}_step{step:02d}.png"
    folder = put(tmp_path / "images", [form.format(set=s + 1, step=n + 1) for s, n in STEPS])
    refuses(
        Chosen((folder,), form),
        r"from set 0 and step 0; they count from set 1 and step 1: --first 1$",
    )
    taken(Chosen((folder,), form, first=1))


def test_only_steps_that_count_from_one(tmp_path: Path) -> None:
    form = "set{set}_step{step}.png"
    folder = put(tmp_path / "images", [form.format(set=s, step=n + 1) for s, n in STEPS])
    refuses(Chosen((folder,), form), "they count from set 0 and step 1: --first 0 --first-step 1$")
    taken(Chosen((folder,), form, first_step=1))


def test_sets_that_lack_steps_or_have_more_are_named(tmp_path: Path) -> None:
    form = "set{set}_step{step}.png"
    folder = put(tmp_path / "images", [form.format(set=s, step=n) for s, n in STEPS])
    (folder / "set0_step3.png").write_bytes((folder / "set0_step2.png").read_bytes())
    refuses(Chosen((folder,), form), r"has 1 images more than the plan's 7 \(set0_step3.png\)")
    (folder / "set1_step1.png").unlink()
    refuses(Chosen((folder,), form), r"1 of the plan's 7 frames are missing \(set1_step1.png\)")
    with pytest.raises(DataError, match=r"1 of 8 images are missing \(set1_step1.png\)"):
        read_images(Chosen((folder,), form))


def test_no_file_of_the_name_says_what_is_there(tmp_path: Path) -> None:
    folder = put(tmp_path / "images", [f"{k:02d}.png" for k in range(7)])
    wrong = Chosen((folder,), "f_{index:02d}.png")
    refuses(wrong, r"7 of the plan's 7 frames .*; the folder has 00.png, 01.png, .* …$")
    with pytest.raises(DataError, match=r"has no image 'f_.*' from index 0; the folder has 00.png, "):
        read_images(wrong)
    with pytest.raises(DataError, match=r"has no image 's.*' from set 0 and step 0; the folder has 00.png, "):
        read_images(Chosen((folder,), "s{set}_{step}.png"))


def test_a_pattern_is_sorted_by_numbers_and_says_so(tmp_path: Path) -> None:
    folder = put(tmp_path / "images", [f"f_{k}.png" for k in (8, 9, 10, 11, 99, 100, 101)])
    (folder / "._f_8.png").write_text("left by another computer")
    taken(Chosen((folder,), "f_*.png"))
    said: list[str] = []
    read_images(Chosen((folder,), "*.png"), tell=said.append)
    assert said == [
        "7 files are taken in the order of the numbers in their names: f_8.png, f_9.png, f_10.png … f_101.png"
    ]


@pytest.mark.parametrize(
    ("last", "said"), [(4, "1.png, 2.png, 3.png, 4.png"), (5, "1.png, 2.png, 3.png … 5.png")]
)
def test_more_than_four_names_are_cut_short(tmp_path: Path, last: int, said: str) -> None:
    put(tmp_path / "images", [f"{k}.png" for k in range(1, last + 1)], IMAGES[:last])
    words: list[str] = []
    read_images(Chosen((tmp_path / "images",), "*.png"), tell=words.append)
    assert words[0].endswith(f": {said}")


def test_a_pattern_with_more_or_fewer_files(tmp_path: Path) -> None:
    folder = put(tmp_path / "images", [f"f_{k}.png" for k in range(7)])
    put(folder, ["f_20.png"], [image_of(20)])
    refuses(
        Chosen((folder,), "*.png"),
        r"has 8 images, and the plan 7: f_20.png would be left over; .*--skip",
    )
    taken(Chosen((folder,), "f_?.png"))
    refuses(
        Chosen((folder,), "f_[0-4].png"),
        "has 5 images, and the plan 7: the last 2 of .* after f_4.png",
    )
    refuses(Chosen((folder,), "*.tif"), r"has no file '\*.tif'; the folder has f_0.png, .*…$")
    refuses(Chosen((folder,), "../*.png"), "a pattern of names below the folder", ConfigError)


@pytest.mark.parametrize("beside", [True, False])
def test_a_list_of_names(tmp_path: Path, beside: bool) -> None:
    names = [f"{letter}.png" for letter in "gacbfde"]
    folder = put(tmp_path / "images", names)
    listed = (folder if beside else tmp_path) / "list.txt"
    listed.write_text("\n".join([*names[:3], "", *names[3:]]) + "\n")
    taken(Chosen(() if beside else (folder,), f"@{listed}"))


@pytest.mark.parametrize("pattern", ["*.png", "f_*.PNG", "F_[0-6].Png"])
def test_a_pattern_finds_capitals_and_small_letters(tmp_path: Path, pattern: str) -> None:
    taken(
        Chosen((put(tmp_path / "images", [f"f_{k}.{'pnG' if k > 3 else 'PNG'}" for k in range(7)]),), pattern)
    )


def test_a_form_names_the_capitals_that_are_there(tmp_path: Path) -> None:
    folder = put(tmp_path / "images", [f"{k}.PNG" for k in range(7)])
    refuses(Chosen((folder,), "{index}.png"), r"7 of the plan's 7 frames .*; the folder has 0\.PNG, ")
    (tmp_path / "list.txt").write_text("0.png")
    refuses(Chosen((folder,), f"@{tmp_path / 'list.txt'}"), r"\(0\.png\); the folder has 0\.PNG, ")


@pytest.mark.parametrize("coding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_list_by_an_editor_of_another_system(tmp_path: Path, coding: str, end: str) -> None:
    names = [f"stück {k}/bild.png" for k in range(7)]
    folder = put(tmp_path / "images", names)
    lines = ["# taken on Friday", f'"{names[0]}"', f"'{names[1]}'", *names[2:5], "", "#"]
    lines += [name.replace("/", "\\") + " " for name in names[5:]]
    mark = "\ufeff" if coding == "utf-16-be" else ""  # the others write it by themselves
    (tmp_path / "list.txt").write_bytes((mark + end.join(lines)).encode(coding))
    taken(Chosen((folder,), f"@{tmp_path / 'list.txt'}"))


@pytest.mark.parametrize(
    "name", ["../elsewhere/f.png", "/etc/hostname", r"C:\f\0.png", r"..\0.png", "C:0.png"]
)
def test_a_list_names_images_below_its_folder(tmp_path: Path, name: str) -> None:
    (tmp_path / "list.txt").write_text(f"{name}\n")
    refuses(Chosen((tmp_path,), f"@{tmp_path / 'list.txt'}"), "which is not below")


def test_a_list_that_is_wrong(tmp_path: Path) -> None:
    folder = put(tmp_path / "images", [f"{k}.png" for k in range(7)])
    listed = tmp_path / "list.txt"
    source = Chosen((folder,), f"@{listed}")
    listed.write_text("\n".join(f"{k}.png" for k in (0, 1, 2, 3, 7, 8, 6)))
    refuses(source, r"images: 2 of 7 files do not exist \(7.png, 8.png\)")
    listed.write_text("\n".join(f"{k}.png" for k in (0, 1, 2, 3, 4, 1, 6)))
    refuses(source, r"1.png: is named twice")
    listed.write_text("\n".join(f"{k}.png" for k in range(6)))
    refuses(source, "has 6 images, and the plan 7: the last 1 of the plan have none after 5.png")
    listed.write_text("\n\n")
    refuses(source, "list.txt: names no image")
    refuses(Chosen((folder,), "@nowhere.txt"), "nowhere.txt", ConfigError)


def test_files_one_by_one_and_the_order_of_a_shell(tmp_path: Path) -> None:
    folder = put(tmp_path / "images", [f"f_{k}.png" for k in range(5, 12)])
    files = tuple(folder / f"f_{k}.png" for k in range(5, 12))
    said: list[str] = []
    np.testing.assert_array_equal(read_images(Chosen(files), warn=said.append)[0], IMAGES)
    read_images(Chosen(files[::-1]), warn=said.append)
    assert said == []
    read_images(Chosen(tuple(sorted(files))), warn=said.append)
    assert len(said) == 1
    assert "the order of the letters in their names, f_10.png, f_11.png, f_5.png … f_9.png" in said[0]
    assert "by their numbers they are f_5.png, f_6.png, f_7.png … f_11.png" in said[0]


@pytest.mark.parametrize(
    ("places", "options", "complaint"),
    [
        (["images"], {}, "--frames is missing: say what the images in .*images are called"),
        (
            ["images/0.png"],
            {"names": "{index}.png"},
            "0.png: is not a folder; --frames names the images of one",
        ),
        (["images", "images"], {"names": "*.png"}, r"--frames is '\*.png': name the one folder"),
        (["images"], {"names": "*.png", "first_step": 1}, "--first-step goes with names that have a {step}"),
        (["images"], {"names": "{index}.png", "first_step": 1}, "--first-step goes with names"),
        (
            ["images"],
            {"names": "{index}.png", "skip": (9,)},
            "--skip is 9: there are 8 images, counted from 0",
        ),
        (["images"], {"names": "*.png", "skip": (7,)}, "--skip names image 7, and there are 7"),
        (["images"], {"names": "{set}{step}.png", "skip": (0,)}, "--skip counts images by one number"),
        (["images"], {"names": "/tmp/{index}.png"}, "expected one {index}"),
        (["images"], {"names": "{set}.png"}, "expected one {index}"),
        (["images"], {"names": "{index:x}.png"}, "expected one {index}"),
    ],
)
def test_a_source_that_does_not_say_which_images(
    tmp_path: Path, places: list[str], options: dict[str, Any], complaint: str
) -> None:
    put(tmp_path / "images", [f"{k}.png" for k in range(7)])
    with pytest.raises(ConfigError, match=complaint):
        Chosen(tuple(tmp_path / place for place in places), **options).images([3, 4])


@pytest.mark.parametrize("first", [0, 1])
def test_white_and_black_images_are_left_out(tmp_path: Path, first: int) -> None:
    images = [np.full_like(IMAGES[0], 240), np.full_like(IMAGES[0], 3), *IMAGES, image_of(77)]
    folder = put(tmp_path / "images", [f"f_{k}.png" for k in range(first, 10 + first)], images)
    skip = (first, first + 1, first + 9)
    refuses(
        Chosen((folder,), "f_{index}.png", first),
        "has 3 images more than the plan's 7 .*--skip leaves",
    )
    for names in ("f_{index}.png", "*.png"):
        source = Chosen((folder,), names, first, skip=skip)
        np.testing.assert_array_equal(read_images(source)[0], IMAGES)
        session = import_images(source, PLAN, tmp_path / "session", force=True)
        np.testing.assert_array_equal(session.stack(), IMAGES)


@pytest.mark.parametrize("kind", ["tif", "npy", "npz"])
def test_one_file_of_all_images(tmp_path: Path, kind: str) -> None:
    stack = tmp_path / f"stack.{kind}"
    if kind == "tif":
        tifffile.imwrite(stack, np.array(IMAGES), photometric="minisblack", compression="zlib")
    elif kind == "npy":
        np.save(stack, np.array(IMAGES))
    else:
        np.savez_compressed(stack, frames=np.array(IMAGES))
    taken(Chosen((stack,)))
    refuses(Chosen((stack,), skip=(0,)), rf"has 6 images, and the plan 7: .* after stack.{kind} image 6")


def test_a_file_for_each_set(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    np.save(folder / "set_0.npy", np.array(IMAGES[:3]))
    tifffile.imwrite(folder / "set_1.tif", np.array(IMAGES[3:]), photometric="minisblack")
    taken(Chosen((folder / "set_0.npy", folder / "set_1.tif")))
    np.testing.assert_array_equal(read_images(Chosen((folder,), "set_*"))[0], IMAGES)
    with pytest.raises(DataError, match=r"set_1.tif: holds 4 images, and --frames names each of them"):
        read_images(Chosen((folder,), "set_{index}.tif", first=1))


@pytest.mark.parametrize(
    ("words", "numbers"), [(None, ()), ("0,1", (0, 1)), ("0-2, 38", (0, 1, 2, 38)), ("5", (5,))]
)
def test_numbers_to_skip(words: str | None, numbers: tuple[int, ...]) -> None:
    assert numbers_of(words) == numbers


@pytest.mark.parametrize("words", ["a", "1,", "2-1", "-1", "1.5"])
def test_what_are_no_numbers(words: str) -> None:
    with pytest.raises(ConfigError, match=f"--skip is '{words}': expected numbers of images"):
        numbers_of(words)
