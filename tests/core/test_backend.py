"""A usable LLVM is found before Dr.Jit looks for one, and what does not work is an error, never an abort."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from etendue.core import (
    BackendError,
    backend,
    choose_variant,
    llvm,
    on_device,
    use_variant,
)

MISSING = str(Path("/nowhere/libLLVM.so.19.1"))


def python(code, **environment):
    """Run ``code`` in a fresh interpreter whose environment names no LLVM unless the test does."""
    names = {k: v for k, v in os.environ.items() if k != llvm.VARIABLE} | environment
    return subprocess.run([sys.executable, "-c", code], env=names, capture_output=True, text=True, timeout=120)


def library(folder, name, link=None):
    """A file that is called like a library (``link``: a symbolic link of that name to it)."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(b"not a library")
    if link is None:
        return folder / name
    (folder / link).symlink_to(name)
    return folder / link


@pytest.mark.parametrize(
    ("name", "link", "major"),
    [
        ("libLLVM.so.19.1", None, 19),
        ("libLLVM.so.20.1", "libLLVM.so", 20),
        ("libLLVM-17.so.1", None, 17),
        ("libLLVM-15.so.1", "libLLVM-15.so", 15),
        ("libLLVM-14.so.1", "libLLVM-14.0.6.so.1", 14),
        ("libLLVM.so.18.1", "libLLVM.so.1", 18),
    ],
)
def test_version_from_the_name(tmp_path, name, link, major):
    assert llvm.version_of(library(tmp_path, name, link)) == major


@pytest.mark.parametrize(
    ("folder", "major"), [("llvm-19/lib", 19), ("opt/llvm@18/lib", 18), ("Cellar/llvm/20.1.7/lib", 20)]
)
def test_version_from_the_folder(tmp_path, folder, major):
    assert llvm.version_of(library(tmp_path / folder, "libLLVM.dylib")) == major


def test_version_by_asking_the_library(tmp_path):
    """A library without a number anywhere is loaded, in another process, and asked."""
    assert llvm.version_of(library(tmp_path, "libLLVM.so")) == 0
    real = llvm.load_usable()
    assert real is not None
    assert llvm._reported_version(real.path) == real.major


def test_other_libraries_of_llvm_are_not_taken_for_it():
    for name in ("libLLVMCore.so.19", "libLLVMSPIRVLib.so.15", "libLLVM-19.txt", "libLLVM.a"):
        assert not llvm._NUMBERED.match(name)


def test_order_of_preference(tmp_path, monkeypatch):
    own = tmp_path / "env" / "native" / "lib"
    monkeypatch.setattr(llvm, "private_directory", lambda: own)
    names = ["libLLVM.so.21.1", "libLLVM-15.so.1", "libLLVM-17.so.1", "libLLVM.so.19.1", "libLLVM.so.20.1"]
    paths = [library(tmp_path / "usr", n) for n in names] + [library(own, "libLLVM.so.18.1")]
    monkeypatch.setattr(llvm, "_candidates", lambda: iter(paths))
    assert [found.major for found in llvm.find()] == [18, 19, 21, 20, 17, 15]


def test_the_private_library_is_preferred_behind_a_link(tmp_path, monkeypatch):
    private = library(tmp_path / "env" / "native" / "lib", "libLLVM.so.18.1")
    (tmp_path / "link").symlink_to("env")
    monkeypatch.setattr(llvm, "private_directory", lambda: tmp_path / "link" / "native" / "lib")
    monkeypatch.setattr(llvm, "_candidates", lambda: iter([library(tmp_path / "usr", "libLLVM.so.19.1"), private]))
    assert [found.major for found in llvm.find()] == [18, 19]


def test_a_broken_library_is_passed_over(tmp_path, monkeypatch):
    real = llvm.load_usable()
    assert real is not None
    broken = library(tmp_path, "libLLVM.so.19.1")
    monkeypatch.setattr(llvm, "find", lambda: [llvm.Library(broken, 19), real])
    assert llvm.load_usable() == real
    monkeypatch.setattr(llvm, "find", lambda: [llvm.Library(broken, 19), llvm.Library(real.path, 15)])
    assert llvm.load_usable() is None


def test_private_libraries_that_do_not_load_are_no_obstacle(tmp_path, monkeypatch):
    library(tmp_path, "libz3.so.4")
    library(tmp_path, "libedit.so.2")
    monkeypatch.setattr(llvm, "private_directory", lambda: tmp_path)
    llvm.load_private()  # ends, and raises nothing


def test_the_library_is_named_before_drjit_is_imported():
    code = """
import os, sys
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "drjit": print(os.environ.get("DRJIT_LIBLLVM_PATH"))
sys.meta_path.insert(0, Watch())
import etendue
"""
    assert python(code).stdout.split() == [str(llvm.load_usable().path)]
    run = python("import etendue.core.backend as b; print(b.use_variant('llvm_ad_rgb'), b.llvm_version()[0])")
    assert run.stdout.split() == ["llvm_ad_rgb", str(llvm.load_usable().major)], run.stderr


def test_a_library_that_the_user_names_is_respected_and_checked():
    code = "import os, etendue.core as c; print(os.environ['DRJIT_LIBLLVM_PATH']); c.use_variant('llvm_ad_rgb')"
    run = python(code, DRJIT_LIBLLVM_PATH=MISSING)
    assert run.stdout.strip() == MISSING
    assert run.returncode == 1
    error = run.stderr.strip().splitlines()[-1]
    assert "BackendError: Dr.Jit found no LLVM" in error
    assert f"DRJIT_LIBLLVM_PATH names {MISSING}; unset it" in error


def test_an_old_llvm_is_an_error_and_no_abort():
    """With a real old library, where this machine has one."""
    old = [found for found in llvm.find() if not found.usable]
    if not old:
        pytest.skip("this machine has no LLVM below 17; the next test covers the message")
    run = python("import etendue.core as c; c.use_variant('llvm_ad_rgb')", DRJIT_LIBLLVM_PATH=str(old[0].path))
    assert run.returncode == 1
    assert "BackendError: Dr.Jit found" in run.stderr


@pytest.mark.parametrize(
    ("version", "says"), [((15, 0, 6), "Dr.Jit found LLVM 15.0.6, but"), (None, "found no LLVM that it can use, but")]
)
def test_what_to_install_is_said(monkeypatch, version, says):
    monkeypatch.setattr(backend, "llvm_version", lambda: version)
    monkeypatch.setattr(llvm, "find", lambda: [llvm.Library(Path("/usr/lib/libLLVM-15.so.1"), 15)])
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(BackendError, match=says) as caught:
        choose_variant("llvm_ad_rgb")
    assert "apt-get install -y libllvm19" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_mitsuba_imported_too_early_is_explained(monkeypatch):
    monkeypatch.setattr(backend, "llvm_version", lambda: (15, 0, 6))
    monkeypatch.setattr(llvm, "find", lambda: [llvm.Library(Path("/usr/lib/libLLVM.so.19.1"), 19)])
    monkeypatch.delenv(llvm.VARIABLE, raising=False)
    with pytest.raises(BackendError, match=r"import etendue before .* or set DRJIT_LIBLLVM_PATH=.*libLLVM\.so\.19\.1"):
        backend.check_llvm()


@pytest.mark.parametrize(
    "name", ["scalar_rgb", "llvm_ad_spectral_polarized", "llvm_ad_mono_polarized", "scalar_spectral", "gpu", ""]
)
def test_other_variants_are_refused_with_those_that_work(name):
    with pytest.raises(BackendError) as caught:
        use_variant(name)
    assert f"'{name}'" in str(caught.value)
    assert "llvm_ad_rgb, cuda_ad_rgb, llvm_ad_spectral" in str(caught.value)


def test_a_variant_set_by_the_user_is_kept_or_refused():
    code = "import mitsuba as mi; mi.set_variant('{}'); from etendue.core import use_variant; print(use_variant())"
    environment = {llvm.VARIABLE: str(llvm.load_usable().path)}
    assert python(code.format("llvm_ad_rgb"), **environment).stdout.strip() == "llvm_ad_rgb"
    run = python(code.format("scalar_rgb"), **environment)
    assert "BackendError: variant 'scalar_rgb' is not supported" in run.stderr.strip().splitlines()[-1]


def test_differentiable_integrators_of_mitsuba_work_under_a_variant_set_here():
    """Their functions are transformed when they are first called. The light of a sphere under a constant sky of
    radiance 1 is its reflectance, and so is the gradient; 65,536 samples, whose standard deviation is less than .1."""
    code = """
import etendue.core
etendue.core.use_variant("llvm_ad_rgb")
import drjit as dr, mitsuba as mi
assert dr.syntax.__module__ == "drjit.ast"
scene = mi.load_dict({
    "type": "scene", "integrator": {"type": "prb", "max_depth": 2}, "light": {"type": "constant"},
    "ball": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": 0.25}},
    "sensor": {"type": "perspective", "fov": 5,
               "to_world": mi.ScalarTransform4f().look_at([0, 0, 9], [0, 0, 0], [0, 1, 0]),
               "film": {"type": "hdrfilm", "width": 4, "height": 4}}})
parameters = mi.traverse(scene)
key = "light.radiance.value"
dr.enable_grad(parameters[key])
picture = mi.render(scene, parameters, spp=4096)
mean = dr.mean(picture.array)
dr.backward(mean)
print(float(mean[0]), float(dr.sum(dr.grad(parameters[key]))[0]))
"""
    done = python(code)
    assert done.returncode == 0, done.stderr
    assert np.allclose([float(word) for word in done.stdout.split()], 0.25, atol=4 * 0.1 / 256)


def test_cuda_is_the_default_where_it_is_usable(monkeypatch):
    monkeypatch.setattr(backend, "cuda_problem", lambda: None)
    assert choose_variant() == "cuda_ad_rgb"
    monkeypatch.setattr(backend, "cuda_problem", lambda: "no device")
    assert choose_variant() == "llvm_ad_rgb"
    with pytest.raises(BackendError, match="'cuda_ad_rgb' cannot be used: no device"):
        choose_variant("cuda_ad_rgb")


@pytest.mark.gpu
def test_cuda_runs_a_kernel():
    code = "from etendue.core import use_variant; use_variant('cuda_ad_rgb'); import drjit as dr, mitsuba as mi;"
    assert python(code + "print(dr.sum(dr.arange(mi.Float, 5)))").stdout.strip() == "[10]"


def test_a_library_that_mitsuba_lacks_is_named():
    code = """
import sys
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name == "drjit": raise ImportError("libatomic.so.1: cannot open shared object file")
sys.meta_path.insert(0, Hide())
import etendue
"""
    error = python(code).stderr.strip().splitlines()[-1]
    assert "BackendError: Dr.Jit or Mitsuba cannot be loaded (libatomic.so.1" in error
    assert "sudo apt-get install -y libatomic1" in error


def test_device_arrays_do_not_borrow_host_memory():
    """The alignment of borrowed memory would be compiled into kernels."""
    bytes_ = np.zeros(4 * 8 + 1, np.uint8)
    values = bytes_[1:].view(np.float32)
    array = on_device(mi.Float, values)
    values[:] = 5.0
    assert np.asarray(array).tolist() == [0.0] * 8
    assert not np.shares_memory(np.asarray(array), values)
