"""EXR files: exact round trips, every stored form, and damaged files as one-line errors."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from model_jax._errors import InputError
from render_gl._exr import read_channels, write_channels
from render_gl._files import check_file, write_whole

DATA = Path(
    os.environ.get("AIRLIGHT_DATA") or Path(__file__).parents[2] / ".." / "shared" / "data"
).resolve()

# Reads the files named in one process; reports each one's message and the children's peak memory.
SWEEP = """
import json, resource, sys
from pathlib import Path
from model_jax._errors import InputError
from render_gl._exr import read_channels

messages = {}
for file in map(Path, sys.argv[1:]):
    try:
        channels, _ = read_channels(file)
    except InputError as error:
        messages[file.name] = str(error)
    else:
        messages[file.name] = None
peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
print(json.dumps({"messages": messages, "peak_kib": peak}))
"""


def data_folder(name: str) -> Path:
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip("../shared/data is absent")
    return folder


def ramp(height: int = 5, width: int = 7) -> np.ndarray:
    return np.arange(height * width, dtype=np.float32).reshape(height, width) / 3


def write_raw(path: Path, channels: dict, **header: object) -> Path:
    """A file as other programs write it."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | header
    OpenEXR.File(header, dict(channels)).write(str(path))
    return path


def subsampled(path: Path) -> None:
    """Luminance and half-size chroma, by changing the header: the binding cannot write one."""
    data = bytearray(write_raw(path, {"Y": ramp(4, 4), "BY": ramp(4, 4)}).read_bytes())
    samplings = data.index(b"BY\0") + 3 + 8  # after the name: type, pLinear and padding
    data[samplings : samplings + 8] = b"\2\0\0\0" * 2
    path.write_bytes(data)


class TestRoundTrip:
    def test_channels_come_back_bit_for_bit(self, tmp_path: Path) -> None:
        special = ramp()
        special[0, :4] = [np.nan, np.inf, -np.inf, -0.0]
        channels = {"front.Z": ramp(), "surface.R": special, "R": ramp() * 1e30}
        write_channels(tmp_path / "a.exr", channels, {})
        read, _ = read_channels(tmp_path / "a.exr")
        assert set(read) == set(channels)
        for name, pixels in channels.items():
            assert read[name].dtype == np.float32
            assert read[name].tobytes() == pixels.tobytes()

    def test_attributes_come_back_exactly(self, tmp_path: Path) -> None:
        attributes = {
            "airlight.near": 0.1,
            "airlight.reference": 1.4959787070000001e8,
            "airlight.tiny": 5e-324,
            "airlight.inf": float("inf"),
            "airlight.count": -7,
            "airlight.hash": "ä | \n 1f",
            "airlight.empty": "",
            "airlight.pair": (0.1, 0.2),
            "airlight.forward": (1 / 3, -2 / 3, 1e-17),
            "airlight.rotation": tuple(np.linspace(0, 1, 9).tolist()),
            "airlight.matrix": tuple(np.linspace(0, 1, 16).tolist()),
        }
        write_channels(tmp_path / "a.exr", {"Z": ramp()}, attributes)
        _, read = read_channels(tmp_path / "a.exr")
        assert {name: read[name] for name in attributes} == attributes
        assert read["compression"] == "ZIP_COMPRESSION"
        assert read["dataWindow"] == ((0, 0), (6, 4))

    def test_one_pixel_and_float64_input(self, tmp_path: Path) -> None:
        write_channels(tmp_path / "a.exr", {"Z": np.full((1, 1), 0.1)}, {})
        assert read_channels(tmp_path / "a.exr")[0]["Z"] == np.float32(0.1)

    def test_same_input_same_bytes_and_arguments_untouched(self, tmp_path: Path) -> None:
        channels, attributes = {"Z": ramp()}, {"airlight.near": 0.1}
        for name in ("a.exr", "b.exr"):
            write_channels(tmp_path / name, channels, attributes)
        assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
        assert type(channels["Z"]) is np.ndarray
        assert attributes == {"airlight.near": 0.1}


@pytest.mark.parametrize(
    ("channels", "attributes", "fragment"),
    [
        pytest.param({}, {}, "at least one", id="no-channel"),
        pytest.param({"A": ramp(), "B": ramp(3)}, {}, "shape", id="two-shapes"),
        pytest.param({"A": np.zeros((0, 3))}, {}, "at least one pixel", id="no-pixel"),
        pytest.param({"": ramp()}, {}, "1 to 255 bytes", id="no-name"),
        pytest.param({"Z": ramp()}, {"n": 2**31}, "32 bits", id="large-int"),
        pytest.param({"Z": ramp()}, {"n": (1.0,) * 4}, "no EXR form", id="four-numbers"),
        pytest.param({"Z": ramp()}, {"n": None}, "no EXR form", id="none"),
        pytest.param({"Z": ramp()}, {"type": "x"}, "belongs to", id="reserved"),
    ],
)
def test_what_exr_cannot_hold_is_refused(
    tmp_path: Path, channels: dict, attributes: dict, fragment: str
) -> None:
    with pytest.raises(InputError, match=fragment):
        write_channels(tmp_path / "a.exr", channels, attributes)
    assert list(tmp_path.iterdir()) == []


class TestForeignFiles:
    @pytest.mark.parametrize(
        ("dtype", "values"),
        [
            pytest.param(np.float16, [0.5, 65504], id="half"),
            pytest.param(np.float32, [0.1, 1e30], id="float"),
            pytest.param(np.uint32, [1, 2**24], id="uint"),
        ],
    )
    def test_every_sample_type_becomes_float32(
        self, tmp_path: Path, dtype: type, values: list
    ) -> None:
        stored: np.ndarray = np.array([values], dtype=dtype)
        read, _ = read_channels(write_raw(tmp_path / "a.exr", {"id": stored}))
        np.testing.assert_array_equal(read["id"], stored.astype(np.float32))

    @pytest.mark.parametrize("method", ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "DWAB", "HTJ2K256"])
    def test_black_pictures_are_plausible_in_every_compression(
        self, tmp_path: Path, method: str
    ) -> None:
        compression = getattr(OpenEXR, f"{method}_COMPRESSION")
        path = write_raw(
            tmp_path / "a.exr", {"Y": np.zeros((700, 3000), "f")}, compression=compression
        )
        assert not read_channels(path)[0]["Y"].any()

    def test_tiles(self, tmp_path: Path) -> None:
        path = write_raw(
            tmp_path / "a.exr",
            {"Y": ramp(70, 90)},
            type=OpenEXR.tiledimage,
            tiles=OpenEXR.TileDescription(),
        )
        np.testing.assert_array_equal(read_channels(path)[0]["Y"], ramp(70, 90))

    def test_data_window_is_placed_in_the_display_window(self, tmp_path: Path) -> None:
        # Data rows 1..5 and columns -2..4 of a display window 4 wide and 3 high.
        path = write_raw(
            tmp_path / "a.exr",
            {"Y": ramp()},
            dataWindow=((-2, 1), (4, 5)),
            displayWindow=((0, 0), (3, 2)),
        )
        expected = np.full((3, 4), np.nan, dtype=np.float32)
        expected[1:] = ramp()[:2, 2:6]
        np.testing.assert_array_equal(read_channels(path)[0]["Y"], expected)

    @pytest.mark.parametrize(
        ("make", "fragment"),
        [
            pytest.param(
                subsampled,
                "'BY' is subsampled by 2×2",
                id="subsampled",
            ),
            pytest.param(
                lambda p: OpenEXR.File(
                    [OpenEXR.Part({}, {"Z": ramp()}, n) for n in ("left", "right")]
                ).write(str(p)),
                r"2 parts \(\['left', 'right'\]\)",
                id="two-parts",
            ),
            pytest.param(
                lambda p: write_raw(p, {"Y": ramp()}, displayWindow=((50, 50), (60, 60))),
                "no pixels inside its display window",
                id="windows-apart",
            ),
            pytest.param(
                lambda p: write_raw(p, {"Y": ramp()}, displayWindow=((0, 0), (10**6, 10**6))),
                "samples, more than",
                id="huge-display-window",
            ),
        ],
    )
    def test_kinds_that_are_not_read_are_named(
        self, tmp_path: Path, make: Callable[[Path], object], fragment: str
    ) -> None:
        path = tmp_path / "a.exr"
        make(path)
        with pytest.raises(InputError, match=fragment):
            read_channels(path)


class TestDamage:
    def test_every_truncation_is_an_error(self, tmp_path: Path) -> None:
        write_channels(tmp_path / "a.exr", {"Z": ramp(40, 30)}, {"airlight.near": 0.1})
        whole = (tmp_path / "a.exr").read_bytes()
        cut = tmp_path / "cut.exr"
        for length in np.linspace(0, len(whole) - 1, 12).astype(int):
            cut.write_bytes(whole[:length])
            with pytest.raises(InputError) as error:
                read_channels(cut)
            assert "\n" not in str(error.value)

    def test_a_flipped_byte_of_the_pixels_is_noticed(self, tmp_path: Path) -> None:
        path = tmp_path / "a.exr"
        write_channels(path, {"Z": ramp(20, 30)}, {})  # noise would be stored raw, unchecked
        damaged = bytearray(path.read_bytes())
        damaged[-100] ^= 0x10
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="its pixels cannot be read"):
            read_channels(path)

    @pytest.mark.parametrize("content", [b"", b"hello", b"\x76\x2f\x31\x01"], ids=repr)
    def test_what_is_no_exr_is_named(self, tmp_path: Path, content: bytes) -> None:
        path = tmp_path / "a.exr"
        path.write_bytes(content)
        with pytest.raises(InputError, match=str(path)):
            read_channels(path)

    @pytest.mark.parametrize("step", [12, pytest.param(1, marks=pytest.mark.full)])
    def test_damaged_files_of_the_openexr_project(self, step: int) -> None:
        """A sample of the 177, or all, in one process: an error of one line each, nothing printed,
        memory and time.

        Bounds: a child may take 1 GiB of address space before a header is accepted; measured peak
        0.17 GiB resident and 0.1 to 0.5 s a file on 2 cores.
        """
        folder = data_folder("openexr_bad")
        files = sorted(f for f in folder.iterdir() if f.name not in ("LICENSE", "README.rst"))
        assert len(files) == 177
        files = files[::step]
        done = subprocess.run(
            [sys.executable, "-c", SWEEP, *map(str, files)],
            capture_output=True,
            check=False,
            text=True,
            cwd=Path(__file__).parents[2],
            timeout=3 * len(files),
        )
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""
        assert done.stdout.count("\n") == 1
        report = json.loads(done.stdout)
        assert len(report["messages"]) == len(files)
        for name, message in report["messages"].items():
            assert message is not None, f"{name} was read"
            assert name in message
            assert "\n" not in message
        assert report["peak_kib"] < 2**20, f"{report['peak_kib']} KiB"

    @pytest.mark.parametrize(
        "name", ["BrightRingsNanInf", "WideFloatRange", "t01", "t02", "t03", "t04"]
    )
    def test_good_files_of_the_openexr_project(self, name: str) -> None:
        path = data_folder("openexr_good") / f"{name}.exr"
        read, _ = read_channels(path)
        reference = OpenEXR.File(str(path), separate_channels=True)
        (x0, y0), (x1, y1) = reference.header()["dataWindow"]
        (left, top), (right, bottom) = reference.header()["displayWindow"]
        assert set(read) == set(reference.channels())
        rows = slice(max(y0, top), min(y1, bottom) + 1)
        columns = slice(max(x0, left), min(x1, right) + 1)
        for key, channel in reference.channels().items():
            expected = np.full((bottom - top + 1, right - left + 1), np.nan, dtype=np.float32)
            expected[
                rows.start - top : rows.stop - top, columns.start - left : columns.stop - left
            ] = channel.pixels[
                rows.start - y0 : rows.stop - y0, columns.start - x0 : columns.stop - x0
            ]
            np.testing.assert_array_equal(read[key], expected)
        if name == "BrightRingsNanInf":
            assert sum(int(np.isnan(pixels).sum()) for pixels in read.values()) == 6
            assert sum(int(np.isinf(pixels).sum()) for pixels in read.values()) == 12


class TestFiles:
    def test_a_failed_write_leaves_the_old_file_and_nothing_else(self, tmp_path: Path) -> None:
        target = tmp_path / "a.txt"
        target.write_text("old")

        def write(path: Path) -> None:
            path.write_text("half")
            raise OSError(28, "No space left on device")

        with pytest.raises(InputError, match=r"a\.txt: could not be written \(No space left"):
            write_whole(target, write)
        assert target.read_text() == "old"
        assert [f.name for f in tmp_path.iterdir()] == ["a.txt"]

    def test_a_full_disk_leaves_no_layer_file(self, tmp_path: Path) -> None:
        """The limit on file size stands for a full disk (signal SIGXFSZ is ignored by Python)."""
        program = (
            "import resource, sys, numpy as np\n"
            "from render_gl._exr import write_channels, InputError\n"
            "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))\n"
            "try:\n"
            "    write_channels(sys.argv[1], {'Z': np.random.rand(200, 200)}, {})\n"
            "except InputError as error:\n"
            "    print(error)\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", program, str(tmp_path / "a.exr")],
            capture_output=True,
            check=False,
            text=True,
            cwd=Path(__file__).parents[2],
        )
        assert done.stdout.startswith(f"{tmp_path / 'a.exr'}: "), done.stderr
        assert done.stdout.count("\n") == 1
        assert list(tmp_path.iterdir()) == []

    def test_a_link_keeps_pointing_at_the_new_file(self, tmp_path: Path) -> None:
        (tmp_path / "real.txt").write_text("old")
        (tmp_path / "link.txt").symlink_to("real.txt")

        def write(path: Path) -> None:
            path.write_text("new")

        write_whole(tmp_path / "link.txt", write)
        assert (tmp_path / "link.txt").is_symlink()
        assert (tmp_path / "real.txt").read_text() == "new"

    def test_missing_and_refusing_folders_are_named(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="no such folder"):
            write_whole(tmp_path / "none" / "a.txt", Path.touch)
        with pytest.raises(InputError, match="is no regular file"):
            write_whole(tmp_path, Path.touch)
        with pytest.raises(InputError, match=r"/proc: cannot write a\.txt there"):
            write_whole("/proc/a.txt", Path.touch)

    def test_unreadable_files_are_named(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "pipe")
        for name, fragment in {
            "none": "no such file",
            ".": "is a folder",
            "pipe": "is a pipe",
            "a\0b": "not a usable path",
        }.items():
            with pytest.raises(InputError, match=fragment):
                check_file(f"{tmp_path}/{name}")
