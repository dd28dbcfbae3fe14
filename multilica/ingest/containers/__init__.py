# SPDX-License-Identifier: Apache-2.0
"""Readers of recordings: bytes of a container to messages."""
