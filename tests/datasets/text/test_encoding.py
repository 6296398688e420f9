"""What people's programs write as text is read as such; what is none is refused with its place."""

from __future__ import annotations

import codecs
import gzip

import numpy as np
import pytest

from certnav.datasets.text.columns import open_text, read_columns
from certnav.datasets.text.encoding import decode
from certnav.datasets.text.tables import read_lines
from certnav.datasets.text.toml_files import read_toml
from certnav.filters.errors import DataError

TEXT = "time,temp [°C],Höhe\r\n1,20.5,3\r\n2,20.5,4\r\n"


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-be"])
def test_columns_in_any_encoding(tmp_path, encoding, packed):
    content = TEXT.encode(encoding)
    if encoding == "utf-16-be":
        content = codecs.BOM_UTF16_BE + content
    file = tmp_path / "f.csv"
    file.write_bytes(gzip.compress(content) if packed else content)
    source = open_text(file)
    assert source.names == ("time", "temp [°C]", "Höhe")
    found = read_columns(source, {"x": ("time", "Höhe")})
    np.testing.assert_array_equal(found.numbers["x"], [[1, 3], [2, 4]])


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_a_declaration_in_any_encoding(tmp_path, encoding):
    file = tmp_path / "a.toml"
    file.write_bytes('name = "Straße"\r\n'.encode(encoding))
    assert read_toml(file)[0] == {"name": "Straße"}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a,b\n1,\xb0\x002\n", r"f:2: expected UTF-8 text, found byte 0x00 \(number 8"),
        (b"\xb0\n\n\x81\n", r"f:3: expected UTF-8 or Windows-1252 text, found byte 0x81 .*UTF-8"),
        ("a,b\n1,2\n".encode("utf-16-le"), r"f:1: .*UTF-16 without a byte order mark .*UTF-8"),
        (b"\xff\xfea\x00\n\x00\x00\xdc", "f:2: expected UTF-16 text, found byte"),
    ],
)
def test_what_is_no_text_is_refused_with_line_and_byte(tmp_path, content, message):
    with pytest.raises(DataError, match=message):
        decode(content, "f")
    file = tmp_path / "f"
    file.write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_lines(file)
