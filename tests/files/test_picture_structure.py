"""Pictures that are cut off or whose parts do not fit are refused before GDAL loops over them or fills them up."""

import numpy as np
import pytest

from tests.files.rasters import colours, write_raster
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.files.picture_structure import check_picture, unpacks_whole


def test_every_shorter_png_is_refused(tmp_path):
    path = write_raster(tmp_path / "a.png", colours(), driver="PNG")
    check_picture(path, "PNG")
    raw = path.read_bytes()
    for length in [*range(8, len(raw), 7), len(raw) - 1]:
        path.write_bytes(raw[:length])
        with pytest.raises(InputError, match="PNG file ends before"):
            check_picture(path, "PNG")


def test_jpeg_2000_cut_off_within_a_box_is_refused(tmp_path):
    path = write_raster(tmp_path / "a.jp2", colours(), driver="JP2OpenJPEG")
    check_picture(path, "JP2OpenJPEG")
    raw = path.read_bytes()
    ends = [raw.index(kind) - 4 for kind in (b"ftyp", b"jp2h", b"uuid", b"asoc", b"jp2c")]
    for length in set(range(ends[1] + 1, ends[-1], 7)) - set(ends):
        path.write_bytes(raw[:length])
        with pytest.raises(InputError, match="impossible lengths"):
            check_picture(path, "JP2OpenJPEG")


def test_boxes_that_do_not_fit_are_refused(tmp_path):
    path = write_raster(tmp_path / "a.jp2", colours(), driver="JP2OpenJPEG")
    raw = path.read_bytes()
    for kind in (b"ftyp", b"jp2h", b"ihdr", b"colr", b"uuid", b"asoc", b"lbl ", b"xml "):
        place = raw.index(kind) - 4
        for length in (0, 2, 7, 2**31, 2**32 - 1) if kind in (b"ihdr", b"colr", b"lbl ", b"xml ") else (2, 7, 2**31):
            path.write_bytes(raw[:place] + length.to_bytes(4, "big") + raw[place + 4 :])
            with pytest.raises(InputError, match="impossible lengths"):
                check_picture(path, "JP2OpenJPEG")


def test_boxes_in_boxes_without_end_are_refused(tmp_path):
    path = tmp_path / "a.jp2"
    nest = b""
    for _ in range(2000):
        nest = (len(nest) + 8).to_bytes(4, "big") + b"asoc" + nest
    path.write_bytes(b"\0\0\0\x0cjP  \r\n\x87\n" + nest)
    with pytest.raises(InputError, match="impossible lengths"):
        check_picture(path, "JP2OpenJPEG")


def test_bare_streams_have_no_boxes(tmp_path):
    raw = write_raster(tmp_path / "a.jp2", colours(), driver="JP2OpenJPEG").read_bytes()
    path = tmp_path / "a.j2k"
    path.write_bytes(raw[raw.index(b"\xff\x4f\xff\x51") :])
    check_picture(path, "JP2OpenJPEG")


def test_jpegs_coarse_to_fine_are_told_from_those_row_by_row(tmp_path):
    for progressive in ("ON", "OFF"):
        path = write_raster(tmp_path / "a.jpg", np.ones((3, 64, 64), np.uint8), driver="JPEG", PROGRESSIVE=progressive)
        assert unpacks_whole(path, "JPEG") == (progressive == "ON")
