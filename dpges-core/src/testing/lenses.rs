//! Lenses of every kind, and cameras with them.

use crate::camera::{Camera, Distortion, Lens, Projection};

/// A lens of every camera model of COLMAP that is no pinhole, by the name of the model.
pub fn every_model() -> [(&'static str, Distortion); 10] {
    let perspective = Distortion::new(Projection::Perspective);
    let fisheye = Distortion::new(Projection::Equidistant);
    [
        ("SIMPLE_RADIAL", Distortion { numerator: [-0.12, 0.0, 0.0, 0.0, 0.0, 0.0], ..perspective }),
        ("RADIAL", Distortion { numerator: [0.08, -0.05, 0.0, 0.0, 0.0, 0.0], ..perspective }),
        (
            "OPENCV",
            Distortion { numerator: [-0.2, 0.05, 0.0, 0.0, 0.0, 0.0], tangential: [0.003, -0.004], ..perspective },
        ),
        (
            "FULL_OPENCV",
            Distortion {
                numerator: [0.2, -0.03, 0.004, 0.0, 0.0, 0.0],
                denominator: [0.3, 0.02, -0.001],
                tangential: [-0.002, 0.001],
                ..perspective
            },
        ),
        ("OPENCV_FISHEYE", Distortion { numerator: [0.04, -0.012, 0.003, -0.0002, 0.0, 0.0], ..fisheye }),
        ("SIMPLE_RADIAL_FISHEYE", Distortion { numerator: [-0.02, 0.0, 0.0, 0.0, 0.0, 0.0], ..fisheye }),
        ("RADIAL_FISHEYE", Distortion { numerator: [-0.04, 0.003, 0.0, 0.0, 0.0, 0.0], ..fisheye }),
        (
            "THIN_PRISM_FISHEYE",
            Distortion {
                numerator: [0.02, -0.01, 0.001, 0.0, 0.0, 0.0],
                tangential: [0.002, -0.001],
                thin_prism: [0.003, -0.002],
                ..fisheye
            },
        ),
        ("FOV", Distortion::new(Projection::FieldOfView(1.3))),
        (
            "RAD_TAN_THIN_PRISM_FISHEYE",
            Distortion {
                numerator: [0.03, -0.012, 0.002, -0.0006, 0.0001, -0.000_01],
                tangential: [0.001, -0.0015],
                thin_prism: [0.002, -0.001],
                thin_prism_quartic: [-0.0005, 0.0003],
                in_sequence: true,
                ..fisheye
            },
        ),
    ]
}

/// `camera` behind a lens, with focal lengths at which wide lenses see `degrees` across its picture; others keep theirs.
pub fn behind(camera: Camera, distortion: Distortion, degrees: f64) -> Camera {
    let lens = Lens::new(distortion);
    if !lens.is_wide() {
        return Camera { lens: Some(lens), ..camera };
    }
    let edge = lens.radial(lens.radius(0.5 * degrees.to_radians()).min(lens.limit()));
    let focal = 0.5 * camera.width as f64 / edge;
    Camera { fx: focal, fy: 1.05 * focal, lens: Some(lens), ..camera }
}
