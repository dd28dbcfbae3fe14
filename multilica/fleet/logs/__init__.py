# SPDX-License-Identifier: Apache-2.0
"""Which logs there are, and in which order they are treated."""
