# SPDX-License-Identifier: Apache-2.0
"""Report of a calibration as one HTML page."""
