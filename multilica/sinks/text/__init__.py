# SPDX-License-Identifier: Apache-2.0
"""Texts that several sinks show."""
