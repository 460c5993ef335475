# Copyright 2026 The tdm_planner authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Machine code on disk is thrown away when a file it was compiled from changes."""

import dis
import importlib
import pkgutil

import pytest
import tdm_planner.direct_method
import tdm_planner.plants
import tdm_planner.problems

dispatcher = pytest.importorskip('numba.core.dispatcher').Dispatcher
PACKAGES = (tdm_planner.direct_method, tdm_planner.plants, tdm_planner.problems)


def kernels():
    for package in PACKAGES:
        for found in pkgutil.iter_modules(package.__path__, f'{package.__name__}.'):
            module = importlib.import_module(found.name)
            for value in vars(module).values():
                if isinstance(value, dispatcher) and value.py_func.__module__ == found.name:
                    yield value


def called(kernel, found):
    """Add all kernels to `found` that become part of a kernel's machine code, itself included."""
    found.add(kernel)
    function = kernel.py_func
    for instruction in dis.get_instructions(function):
        is_global = instruction.opname == 'LOAD_GLOBAL'
        other = function.__globals__.get(instruction.argval) if is_global else None
        if isinstance(other, dispatcher) and other not in found:
            called(other, found)
    return found


def known(kernel):
    """Stamps of all files that the cache of a kernel looks at, and what they are nested in."""
    found = [kernel._cache._cache_file._source_stamp]
    for stamp in found:
        if isinstance(stamp, tuple):
            found += stamp
    return found


def test_every_file_that_a_kernel_is_compiled_from_is_known_to_its_cache():
    unknown = {
        f'{kernel.py_func.__module__}.{kernel.py_func.__name__}': other.py_func.__name__
        for kernel in kernels()
        for other in called(kernel, set())
        if other._cache._impl.locator.get_source_stamp() not in known(kernel)
    }
    assert not unknown
