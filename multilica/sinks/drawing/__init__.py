# SPDX-License-Identifier: Apache-2.0
"""Shapes, colours and samples shared by the sinks."""
