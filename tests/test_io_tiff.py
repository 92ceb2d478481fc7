"""TIFF stacks, and directories of pictures."""

import numpy as np
import pytest

import voluminous as vm
from contracts import ReaderContract
from scanner_files import RNG, VALUES


def tiff(path, values, **options):
    import tifffile

    # Else tifffile takes three or four pages for colours.
    tifffile.imwrite(path, values, **{"photometric": "minisblack", **options})
    return path


def of_pages(values):
    """Return the field that pages (z, rows, columns) should become."""
    return values.transpose(2, 1, 0)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": "zlib"},
        {"compression": "zlib", "predictor": True, "tile": (16, 16)},
        {"bigtiff": True, "byteorder": ">"},
        {"metadata": None},
        {"metadata": None, "compression": "zlib"},
        {"truncate": True},
        {"volumetric": True, "tile": (16, 16, 16)},
        {"imagej": True},
        {"ome": True},
    ],
    ids=str,
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_tiff_stacks(tmp_path, options, dtype):
    values = RNG.integers(0, 200, (5, 20, 30)).astype(dtype)
    volume = vm.open(tiff(tmp_path / "stack.tif", values, **options))
    assert volume.array("stack").dtype == dtype
    np.testing.assert_array_equal(volume.array("stack"), of_pages(values))
    np.testing.assert_array_equal(volume.grid.bounds, [[0, 30], [0, 20], [0, 5]])


def test_imagej_and_ome_tell_the_size_of_voxels(tmp_path):
    values = RNG.integers(0, 200, (2, 5, 3, 20, 30)).astype(np.uint16)
    axes = {"axes": "TZCYX"}
    imagej = tiff(
        tmp_path / "cell.tif",
        values,
        imagej=True,
        resolution=(4.0, 2.0),
        metadata={**axes, "spacing": 1.5, "unit": "um"},
    )
    sizes = {"PhysicalSizeX": 0.25, "PhysicalSizeY": 500.0, "PhysicalSizeYUnit": "nm"}
    ome = tiff(
        tmp_path / "cell.ome.tif",
        values,
        ome=True,
        compression="zlib",
        metadata={**axes, **sizes, "PhysicalSizeZ": 1.5},
    )
    for path in (imagej, ome):
        volume = vm.open(path, time=1)
        assert volume.unit == "um"
        np.testing.assert_allclose(volume.grid.bounds, [[0, 7.5], [0, 10], [0, 7.5]])
        assert volume.fields == ("cell_0", "cell_1", "cell_2")
        for k, name in enumerate(volume.fields):
            np.testing.assert_array_equal(volume.array(name), of_pages(values[1, :, k]))
    given = vm.open(ome, "cell_2", spacing=(1, 2, 3), unit="mm")
    np.testing.assert_allclose(given.grid.bounds, [[0, 30], [0, 40], [0, 15]])
    assert given.unit == "mm"


def test_ome_channels_have_names_and_colours(tmp_path):
    values = RNG.integers(0, 200, (5, 3, 20, 30)).astype(np.uint16)
    told = {"Name": ["DAPI", "GFP 2", ""], "Color": [65535, 16711935, -16776961]}
    path = tiff(
        tmp_path / "cell.ome.tif", values, ome=True, metadata={"axes": "ZCYX", "Channel": told}
    )
    volume = vm.open(path)
    assert volume.fields == ("DAPI", "GFP_2", "cell_2")
    for k, name in enumerate(volume.fields):
        np.testing.assert_array_equal(volume.array(name), of_pages(values[:, k]))
    assert volume.meta["channels"] == {
        "DAPI": {"label": "DAPI", "color": [0, 0, 1]},
        "GFP_2": {"label": "GFP 2", "color": [0, 1, 0]},
        "cell_2": {"color": [1, 0, 0]},
    }
    assert volume.meta["y_down"] is True
    asked = vm.open(path, {"green": "GFP_2"})
    assert asked.meta["channels"] == {"green": {"label": "GFP 2", "color": [0, 1, 0]}}
    assert vm.open(path, name="a").fields == ("a_0", "a_1", "a_2")
    volume.save(tmp_path / "kept.h5")
    assert vm.open(tmp_path / "kept.h5").meta == volume.meta


def test_a_picture_is_no_volume(tmp_path):
    import tifffile

    from voluminous.cli.data import is_image

    flat = tiff(tmp_path / "flat.tif", VALUES[0])
    pyramid = tmp_path / "pyramid.tif"
    with tifffile.TiffWriter(pyramid) as file:
        file.write(np.zeros((64, 64), np.uint8), tile=(16, 16))
        file.write(np.zeros((32, 32), np.uint8), tile=(16, 16), subfiletype=1)
    for path in (flat, pyramid):
        assert is_image(path)
        with pytest.raises(vm.FileFormatError, match="an image is no volume"):
            vm.open(path)
    for options in ({}, {"truncate": True}, {"imagej": True}, {"ome": True}):
        assert not is_image(tiff(tmp_path / "stack.tif", VALUES.astype(np.uint8), **options))


def write_pictures(directory, pages, ending, start=8):
    """Write pictures whose numbers are sorted otherwise than their names."""
    from PIL import Image

    directory.mkdir()
    for number, page in enumerate(pages, start):
        path = directory / f"scan_{number}.{ending}"
        if ending == "png":
            Image.fromarray(page).save(path)
        else:
            tiff(path, page, compression="zlib", photometric="rgb" if page.ndim > 2 else None)
    (directory / "scan.log").write_text("voltage = 60 kV")
    (directory / ".hidden.raw").write_bytes(b"")
    return directory


@pytest.mark.parametrize("ending", ["tif", "png"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_directory_of_numbered_pictures(tmp_path, ending, dtype):
    pages = RNG.integers(0, np.iinfo(dtype).max, (5, 20, 30)).astype(dtype)
    volume = vm.open(write_pictures(tmp_path / "tooth", pages, ending), spacing=0.5, unit="mm")
    assert volume.array("tooth").dtype == dtype
    np.testing.assert_array_equal(volume.array("tooth"), of_pages(pages))
    np.testing.assert_array_equal(volume.grid.bounds, [[0, 15], [0, 10], [0, 2.5]])


class TestTIFF(ReaderContract):
    @pytest.fixture
    def sample(self):
        def write(directory):
            return tiff(directory / "a.tif", VALUES.astype(np.uint8), compression="zlib")

        return write


class TestPictures(ReaderContract):
    @pytest.fixture(params=["tif", "png"])
    def sample(self, request):
        pages = VALUES.astype(np.uint8)
        return lambda directory: write_pictures(directory / "tooth", pages, request.param)

    def victims(self, path):
        return sorted(path.glob("scan_9.*"))


def ome_set(folder, values, counts, companion=""):
    """Write the planes of a volume into several files, as microscopes do; return their paths."""
    import tifffile

    names = [f"part_{k}.ome.tif" for k in range(len(counts))]
    planes = [(k, ifd) for k, count in enumerate(counts) for ifd in range(count)]
    data = "".join(
        f'<TiffData IFD="{ifd}" FirstZ="{z}" PlaneCount="1">'
        f'<UUID FileName="{names[k]}">urn:uuid:{k}</UUID></TiffData>'
        for z, (k, ifd) in enumerate(planes)
    )
    depth, rows, columns = values.shape
    head = '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" '
    pixels = (
        '<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeC="1" '
        f'SizeT="1" SizeX="{columns}" SizeY="{rows}" SizeZ="{depth}" PhysicalSizeX="2" '
        f'PhysicalSizeZ="3"><Channel ID="Channel:0"/>{data}</Pixels></Image></OME>'
    )
    for k, name in enumerate(names):
        text = f'{head}UUID="urn:uuid:{k}">{pixels}'
        if companion:
            text = f'{head}UUID="urn:uuid:{k}"><BinaryOnly MetadataFile="{companion}"/></OME>'
        own = [z for z, (file, _) in enumerate(planes) if file == k]
        with tifffile.TiffWriter(folder / name) as file:
            for z in own:
                file.write(
                    values[z],
                    contiguous=False,
                    description=text if z == own[0] else None,
                    metadata=None,
                )
    if companion:
        (folder / companion).write_text(f'{head}UUID="urn:uuid:c">{pixels}')
    return [folder / name for name in names]


@pytest.mark.parametrize("companion", ["", "set.companion.ome"])
@pytest.mark.parametrize("counts", [(3, 2), (1, 1, 1, 1, 1), (5,)])
def test_a_volume_in_several_files_is_read_from_all(tmp_path, counts, companion):
    values = RNG.integers(0, 9999, (5, 6, 7)).astype(np.uint16)
    paths = ome_set(tmp_path, values, counts, companion)
    for path in paths:  # whichever is opened
        volume = vm.open(path)
        np.testing.assert_array_equal(volume.array(volume.fields[0]), of_pages(values))
        np.testing.assert_array_equal(volume.grid.bounds, [[0, 14], [0, 12], [0, 15]])
    gone = tmp_path / companion if companion else paths[-1]
    gone.unlink()
    if companion or len(counts) > 1:
        with pytest.raises(vm.FileFormatError, match=f"there is no .*{gone.name} beside it"):
            vm.open(paths[0])


def test_files_that_announce_more_pictures_than_they_hold(tmp_path):
    import tifffile

    values = RNG.integers(0, 200, (3, 6, 7)).astype(np.uint8)
    ome = (
        '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">'
        '<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" '
        'SizeX="7" SizeY="6" SizeZ="5" SizeC="1" SizeT="1">{}'
        '<Channel ID="Channel:0"/></Pixels></Image></OME>'
    )
    told = {
        "imagej": "ImageJ=1.53t\nimages=10\nslices=5\nframes=2\nhyperstack=true\n",
        "shaped": '{"shape": [5, 6, 7]}',
        "ome": ome.format(""),
        "ome_data": ome.format('<TiffData IFD="0" PlaneCount="5"/>'),
    }
    for name, text in told.items():
        with tifffile.TiffWriter(tmp_path / f"{name}.tif") as file:
            for z, plane in enumerate(values):
                description = None if z else text
                file.write(plane, description=description, metadata=None, contiguous=False)
        with pytest.raises(vm.FileFormatError, match="its description announces"):
            vm.open(tmp_path / f"{name}.tif")
