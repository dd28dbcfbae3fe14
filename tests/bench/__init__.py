# SPDX-License-Identifier: Apache-2.0
"""Measurements over many scenes: `python -m tests.bench [NAME...]`."""
