"""Images and volumes from files, and masks and labels back to files in the same geometry."""

from segment.picture.dicom_series import holds_dicom, is_dicom_file
from segment.picture.geometry import Geometry
from segment.picture.picture import Picture
from segment.picture.reader import PICTURE_ENDINGS, parse_picture, read_picture, read_picture_mask
from segment.picture.writer import LABEL_ENDINGS, MASK_ENDINGS, VOLUME_ENDINGS, write_labels, write_mask

__all__ = [
    "LABEL_ENDINGS",
    "MASK_ENDINGS",
    "PICTURE_ENDINGS",
    "VOLUME_ENDINGS",
    "Geometry",
    "Picture",
    "holds_dicom",
    "is_dicom_file",
    "parse_picture",
    "read_picture",
    "read_picture_mask",
    "write_labels",
    "write_mask",
]
