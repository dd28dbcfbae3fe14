# SPDX-License-Identifier: Apache-2.0
"""The choice of what a snapshot contains."""
