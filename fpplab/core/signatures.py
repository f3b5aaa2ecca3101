"""What a file is by its first bytes, for files that hold no picture that is read."""

HEAD_BYTES = 512  # how much of a file tells what it is

_SIGNATURES = {
    b"%PDF": "a PDF document",
    b"%!PS": "a PostScript document",
    b"\x1a\x45\xdf\xa3": "a video (Matroska or WebM)",
    b"\x30\x26\xb2\x75\x8e\x66\xcf\x11": "a video (WMV)",
    b"\x00\x00\x01\xba": "a video (MPEG)",
    b"\x00\x00\x01\xb3": "a video (MPEG)",
    b"FLV": "a video (FLV)",
    b"LUCAM-RECORDER": "a video (SER)",
    b"GIF8": "a GIF picture",
    b"\x00\x00\x00\x0cjP  ": "a JPEG 2000 picture",
    b"\xff\x4f\xff\x51": "a JPEG 2000 picture",
    b"\x00\x00\x00\x0cJXL ": "a JPEG XL picture",
    b"\xff\x0a": "a JPEG XL picture",
    b"II\xbc\x01": "a JPEG XR picture",
    b"8BPS": "a Photoshop document",
    b"v/1\x01": "an OpenEXR picture of floating-point numbers",
    b"#?RADIANCE": "a Radiance HDR picture of floating-point numbers",
    b"SIMPLE  =": "a FITS file",
    b"FUJIFILMCCD-RAW": "a camera's raw file (RAF)",
    b"IIRO": "a camera's raw file (ORF)",
    b"IIRS": "a camera's raw file (ORF)",
    b"IIU\x00": "a camera's raw file (RW2)",
    b"FOVb": "a camera's raw file (X3F)",
    b"MATLAB": "a MATLAB file",
    b"\x89HDF": "an HDF5 file",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive",
    b"Rar!": "a RAR archive",
    b"\x1f\x8b": "a gzip archive",
    b"version https://git-lfs": "a pointer of Git LFS in place of the file ('git lfs pull' fetches it)",
}
_BRANDS = {
    b"avi": "an AVIF picture",
    b"hei": "a HEIF picture",
    b"hev": "a HEIF picture",
    b"mif": "a HEIF picture",
    b"msf": "a HEIF picture",
    b"crx": "a camera's raw file (CR3)",
}
_RIFF = {b"AVI ": "a video (AVI)", b"WEBP": "a WebP picture"}
_RAW_TIFF = (b"II*\x00\x10\x00\x00\x00CR", b"IIII*\x00")


def kind_of(head: bytes) -> str | None:
    """Name what the first bytes of a file say that it is; None where they say nothing."""
    if head[:4] == b"RIFF":
        return _RIFF.get(head[8:12])
    if head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide"):
        return _BRANDS.get(head[8:11] if head[4:8] == b"ftyp" else b"", "a video (MP4 or QuickTime)")
    if head.startswith(_RAW_TIFF):
        return "a camera's raw file (CR2)"
    if head[128:132] == b"DICM":
        return "a DICOM file"
    if head[257:262] == b"ustar":
        return "a tar archive"
    by_signature = next((kind for start, kind in _SIGNATURES.items() if head.startswith(start)), None)
    return by_signature or _kind_of_text(head)


def _kind_of_text(head: bytes) -> str | None:
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "a text file (UTF-16)"
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    if start.startswith((b"<!doctype html", b"<html")):
        return "a page in HTML"
    if start.startswith(b"<svg") or (start.startswith(b"<?xml") and b"<svg" in start):
        return "an SVG drawing"
    try:
        text = head.decode("utf-8", errors="strict" if len(head) < HEAD_BYTES else "ignore")
    except UnicodeDecodeError:
        return None
    is_text = bool(text.strip()) and all(sign.isprintable() or sign in "\t\r\n\f\ufeff" for sign in text)
    return "a text file" if is_text else None
