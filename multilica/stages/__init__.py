# SPDX-License-Identifier: Apache-2.0
"""The stages of a calibration, each a function of values."""
