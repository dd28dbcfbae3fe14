# SPDX-License-Identifier: Apache-2.0
"""Evidence from beams: range images, visibility scores, moving points."""
