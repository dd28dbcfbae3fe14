# SPDX-License-Identifier: Apache-2.0
"""Folders of logs, and the names of what is found in them."""

from multilica.fleet.listing import find_logs


def write_files(top, *paths):
    for path in paths:
        (top / path).parent.mkdir(parents=True, exist_ok=True)
        (top / path).write_text(path)
    return top


def sources(*given):
    return [log.source for log in find_logs([str(each) for each in given])]
