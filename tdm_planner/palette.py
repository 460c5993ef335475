# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Colours of plots and reports, told apart by people with any colour vision."""

# After Okabe and Ito, darkened where they are pale on white.
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#c05d94', '#9a7400', '#6f6fc8', '#5c7f8a', '#a0522d')
LIMIT = '#c43d3d'
SWITCH = '#8a8f98'
