"""Half and difference angles of two directions by vectors (Rusinkiewicz 1998)."""

import numpy as np


def half_and_difference(theta_i, phi_i, theta_o, phi_o):
    """(theta_h, theta_d, phi_d), rad."""
    light, view = (
        np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
        for t, p in ((theta_i, phi_i), (theta_o, phi_o))
    )
    half = (light + view) / np.linalg.norm(light + view)
    theta_h, phi_h = np.arccos(half[2]), np.arctan2(half[1], half[0])
    about_z = np.array([[np.cos(phi_h), np.sin(phi_h), 0], [-np.sin(phi_h), np.cos(phi_h), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(theta_h), 0, -np.sin(theta_h)], [0, 1, 0], [np.sin(theta_h), 0, np.cos(theta_h)]])
    difference = about_y @ about_z @ light
    return theta_h, np.arccos(np.clip(difference[2], -1, 1)), np.arctan2(difference[1], difference[0])
