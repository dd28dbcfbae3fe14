# SPDX-License-Identifier: Apache-2.0
"""The stages of a calibration, each a pure function of values and its own section of the configuration."""
