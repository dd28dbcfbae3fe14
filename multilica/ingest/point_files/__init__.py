# SPDX-License-Identifier: Apache-2.0
"""Decoders of point cloud files with one frame per file."""
