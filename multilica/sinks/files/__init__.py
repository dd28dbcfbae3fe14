# SPDX-License-Identifier: Apache-2.0
"""Result files for programs and people."""
