# SPDX-License-Identifier: Apache-2.0
"""The program that unpacks the points of a LAZ file, in a process of its own; see las.py."""

import resource
import sys
from io import BytesIO

import lazrs


def main(arguments: list[str]) -> int:
    """Read the file from standard input and write the unpacked records to standard output.

    Args:
        arguments: position of the points, bytes of all records, bytes of memory, laszip's record in hexadecimal.

    Returns:
        1 if the points cannot be unpacked.
    """
    points_at, size, memory_bytes = (int(argument) for argument in arguments[:3])
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    source = BytesIO(sys.stdin.buffer.read())
    source.seek(points_at)
    records = bytearray(size)
    try:
        lazrs.LasZipDecompressor(source, bytes.fromhex(arguments[3])).decompress_many(records)
    except lazrs.LazrsError:
        return 1
    sys.stdout.buffer.write(records)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
