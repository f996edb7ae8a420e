"""
Inverse rendering through the camera
====================================

A roughness is recovered from a photograph by differentiating Mitsuba's rendering. Without the camera's kernel, its blur is taken for
roughness. :class:`matcam.exchange.MitsubaFilm` is that kernel as a differentiable step behind the rendering.
"""

import drjit as dr
import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np

import matcam

mi.set_variant("llvm_ad_rgb")
AUTOMATIC = dr.detail.llvm_version()[0] >= 17  # older ones lack an instruction that Mitsuba needs
if not AUTOMATIC:
    mi.set_variant("scalar_rgb")  # and derivatives from two renderings

# %%
# A metal sphere under a distant lamp, on a film of 4 x 4 subpixels a pixel with a box filter.
PIXELS, SUBPIXELS, TRUE = 40, 4, 0.02


def scene(alpha):
    """The sphere with a rough metal of this alpha."""
    side = PIXELS * SUBPIXELS
    film = {"type": "hdrfilm", "width": side, "height": side, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    view = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "prb" if AUTOMATIC else "path", "max_depth": 2},
            "sensor": {"type": "orthographic", "to_world": view @ mi.ScalarTransform4f().scale(0.5), "film": film},
            "lamp": {"type": "directional", "direction": [-0.4, -0.2, -1], "irradiance": 1.0},
            "ball": {"type": "sphere", "bsdf": {"type": "roughconductor", "distribution": "ggx", "alpha": alpha}},
        }
    )


# %%
# The photograph: the true roughness through a lens of 0.8 px, with 0.5 % noise.
camera = matcam.Camera(matcam.GaussianOptics(0.8))
film = matcam.exchange.MitsubaFilm(camera, subpixels=SUBPIXELS)
photograph = film.record(np.array(mi.render(scene(TRUE), spp=16, seed=7)))
photograph += 0.005 * photograph.max() * np.random.default_rng(0).standard_normal(photograph.shape)

# %%
# Gauss-Newton steps in ln alpha. The kernel is linear, so the derivative of the rendering goes through it, too.
pinhole = matcam.exchange.MitsubaFilm(matcam.Camera(matcam.GaussianOptics(1e-3)), subpixels=SUBPIXELS)


def automatic(step, log_alpha, seed):
    """Record and derivative by ln alpha, in one rendering: Dr.Jit goes through the kernel."""
    model = scene(float(np.exp(log_alpha)))
    params = mi.traverse(model)
    x = mi.Float(log_alpha)
    dr.enable_grad(x)
    params["ball.bsdf.alpha.value"] = dr.exp(x)
    params.update()
    record = step(mi.render(model, params, spp=16, seed=seed))
    dr.forward(x)
    return np.array(record), np.array(record.grad)


def by_difference(step, log_alpha, seed, apart=0.01):
    """The same from two renderings with the same random numbers."""
    low, high = (
        step.record(np.array(mi.render(scene(float(np.exp(log_alpha + move))), spp=16, seed=seed)))
        for move in (-apart, apart)
    )
    return (low + high) / 2, (high - low) / (2 * apart)


def recover(step, start=0.06, steps=8):
    """Values of alpha from step to step."""
    log_alpha, history = np.log(start), [start]
    for number in range(steps):
        record, slope = (automatic if AUTOMATIC else by_difference)(step, log_alpha, number)
        residual = photograph - record
        change = float((slope * residual).sum() / (slope**2).sum())
        log_alpha = float(np.clip(log_alpha + np.clip(change, -0.7, 0.7), np.log(0.003), np.log(0.5)))
        history.append(np.exp(log_alpha))
    return history


with_camera, without = recover(film), recover(pinhole)
print(f"true roughness {TRUE}, with the camera {with_camera[-1]:.4f}, without {without[-1]:.4f}")

# %%
fig, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
axes[0].imshow((photograph / photograph.max()).clip(0, 1) ** 0.4)
axes[0].set(title="photograph", xticks=[], yticks=[])
axes[1].plot(without, "s-", color="#D55E00", label="a pinhole")
axes[1].plot(with_camera, "o-", color="#0072B2", label="the camera's kernel")
axes[1].axhline(TRUE, color="black", lw=0.8, ls="--", label="true")
axes[1].set(title="recovered roughness", xlabel="step", ylabel="alpha", yscale="log")
axes[1].legend()
plt.show()
