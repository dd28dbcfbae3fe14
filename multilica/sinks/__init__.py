# SPDX-License-Identifier: Apache-2.0
"""What becomes of the events of a calibration: files that people and programs open."""
