# SPDX-License-Identifier: Apache-2.0
"""Modules that tasks use, imported once for all worker processes."""
