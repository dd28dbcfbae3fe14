# SPDX-License-Identifier: Apache-2.0
"""Decoders of messages: bytes of a message to points or transforms."""
