# SPDX-License-Identifier: Apache-2.0
# A header as Doxygen reads it: its first lines are its description, pages that a comment names are links.
1s|.*|/// @file|
2s|^/// [^ ]*: *(.)|/// \u\1|
s#(///.*)docs/results/([a-z_]+)\.md#\1@ref results_\2#
s#(///.*)docs/([a-z_]+)\.md#\1@ref \2#
