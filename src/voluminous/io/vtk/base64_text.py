"""Bytes written as base64, decoded piece by piece."""

from __future__ import annotations

import base64
import binascii
from typing import IO

from ...errors import FileFormatError

_PIECE = 1 << 20
_SPACES = b" \t\r\n"


class Base64Text:
    """What base64 in a file stands for, as a stream of bytes.

    Padding ends one stretch of base64; reading goes on with the next, since some programs encode
    an array's length and its values separately.

    Parameters
    ----------
    file : binary file
        At the first character.
    end : int or None
        Byte at which the text ends; None for the file's end, or the first ``<``.
    """

    def __init__(self, file: IO[bytes], end: int | None) -> None:
        self._file, self._end = file, end
        self._text = b""  # characters not decoded yet
        self._bytes = b""  # decoded, and not asked for yet
        self._ended = False

    def read(self, size: int) -> bytes:
        """Return the next bytes; fewer only at the end."""
        pieces, found = [self._bytes], len(self._bytes)
        while found < size:
            piece = self._decoded()
            if not piece and self._ended:
                break
            pieces.append(piece)
            found += len(piece)
        whole = b"".join(pieces)
        self._bytes = whole[size:]
        return whole[:size]

    def _decoded(self) -> bytes:
        """Return some bytes, at most up to the next padding."""
        if len(self._text) < 4:
            self._fill()
        mark = self._text.find(b"=")
        size = len(self._text) - len(self._text) % 4
        if 0 <= mark < size:
            size = mark - mark % 4 + 4
        part, self._text = self._text[:size], self._text[size:]
        if self._ended and not part and self._text:
            raise FileFormatError("base64 text is cut short")
        try:
            return base64.b64decode(part, validate=True)
        except binascii.Error as error:
            raise FileFormatError(f"expected base64 text ({error})") from error

    def _fill(self) -> None:
        """Read more characters."""
        size = _PIECE if self._end is None else min(_PIECE, self._end - self._file.tell())
        piece = self._file.read(size) if size > 0 else b""
        self._ended = not piece
        if self._end is None and b"<" in piece:
            piece, self._end = piece[: piece.index(b"<")], 0
        self._text += piece.translate(None, _SPACES)
