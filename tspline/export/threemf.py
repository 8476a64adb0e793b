"""3MF of a triangle mesh: a zip archive of three small XML parts (3MF Core Specification 1.3)."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import numpy.typing as npt

__all__ = ["threemf_bytes"]

TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
    "</Types>\n"
)
RELATIONS = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="/3D/3dmodel.model" Id="rel0" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    "</Relationships>\n"
)
#: Rows formatted at a time.
BLOCK = 65536


def threemf_bytes(vertices: npt.ArrayLike, faces: npt.ArrayLike, unit: str) -> bytes:
    """Vertices (n, 3) in `unit` (micron, millimeter, centimeter, inch, foot, meter) and faces (m, 3) as 3MF."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as archive:
        # A date of its own, so that equal meshes make equal files.
        for name, text in (("[Content_Types].xml", TYPES), ("_rels/.rels", RELATIONS)):
            archive.writestr(_entry(name), text)
        with archive.open(_entry("3D/3dmodel.model"), "w", force_zip64=True) as model:
            model.write(
                f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="{unit}" xml:lang="en-US" '
                'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
                '<resources><object id="1" type="model"><mesh><vertices>\n'.encode()
            )
            points = np.asarray(vertices, dtype=np.float64)
            for at in range(0, len(points), BLOCK):
                rows = points[at : at + BLOCK].tolist()
                model.write("".join(f'<vertex x="{x!r}" y="{y!r}" z="{z!r}"/>\n' for x, y, z in rows).encode())
            model.write(b"</vertices><triangles>\n")
            corners = np.asarray(faces)
            for at in range(0, len(corners), BLOCK):
                rows = corners[at : at + BLOCK].tolist()
                model.write("".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>\n' for a, b, c in rows).encode())
            model.write(b'</triangles></mesh></object></resources><build><item objectid="1"/></build></model>\n')
    return buffer.getvalue()


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry
