# SPDX-License-Identifier: Apache-2.0
"""Building blocks that the scenes are made of."""
