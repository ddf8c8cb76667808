//! COLMAP's camera models (`src/colmap/sensor/models.h`).

use std::path::Path;

use dpges_core::camera::{Camera, CameraFromWorld, Distortion, Projection};

use super::super::source::{PanoramaPart, lens};
use super::radial_fit;
use crate::error::{DatasetError, Result};

/// Largest error of a lens that is fitted, px.
const MOST_ERROR_PX: f64 = 0.05;

/// Models by numeric id: name and number of parameters.
const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
];

/// Name and number of parameters of the model with numeric `id`.
pub(super) fn by_id(id: i32) -> Option<(&'static str, usize)> {
    usize::try_from(id).ok().and_then(|id| MODELS.get(id)).copied()
}

/// A camera as stored in the file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CameraRecord {
    pub id: u32,
    pub model: String,
    /// px.
    pub width: u64,
    pub height: u64,
    pub params: Vec<f64>,
}

impl CameraRecord {
    /// Of a panorama that of its front.
    ///
    /// # Errors
    /// [`DatasetError::CameraModel`] for unknown models, [`DatasetError::Malformed`] for a wrong number of parameters.
    pub fn camera(&self, path: &Path, camera_from_world: CameraFromWorld) -> Result<(Camera, Option<PanoramaPart>)> {
        let size = [self.width, self.height].map(|side| side as usize);
        let perspective = Distortion::new(Projection::Perspective);
        let bent = |k: [f64; 6], tangential: [f64; 2]| Distortion {
            numerator: [k[0], k[1], k[2], 0.0, 0.0, 0.0],
            denominator: [k[3], k[4], k[5]],
            tangential,
            ..perspective
        };
        let fisheye = |[k1, k2, k3, k4]: [f64; 4]| Distortion {
            numerator: [k1, k2, k3, k4, 0.0, 0.0],
            ..Distortion::new(Projection::Equidistant)
        };
        let (focal, centre, distortion) = match (self.model.as_str(), self.params.as_slice()) {
            ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f], [cx, cy], perspective),
            ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy], perspective),
            ("SIMPLE_RADIAL", &[f, cx, cy, k]) => ([f, f], [cx, cy], bent([k, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2])),
            ("RADIAL", &[f, cx, cy, k1, k2]) => ([f, f], [cx, cy], bent([k1, k2, 0.0, 0.0, 0.0, 0.0], [0.0; 2])),
            ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
                ([fx, fy], [cx, cy], bent([k1, k2, 0.0, 0.0, 0.0, 0.0], [p1, p2]))
            }
            ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
                ([fx, fy], [cx, cy], bent([k1, k2, k3, k4, k5, k6], [p1, p2]))
            }
            ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => ([fx, fy], [cx, cy], fisheye([k1, k2, k3, k4])),
            ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => ([f, f], [cx, cy], fisheye([k, 0.0, 0.0, 0.0])),
            ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => ([f, f], [cx, cy], fisheye([k1, k2, 0.0, 0.0])),
            ("THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, s1, s2]) => {
                let radial = fisheye([k1, k2, k3, k4]);
                ([fx, fy], [cx, cy], Distortion { tangential: [p1, p2], thin_prism: [s1, s2], ..radial })
            }
            // its p₀ and p₁ are the other way round
            ("RAD_TAN_THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3]) => {
                let bent = Distortion {
                    numerator: [k0, k1, k2, k3, k4, k5],
                    tangential: [p1, p0],
                    thin_prism: [s0, s2],
                    thin_prism_quartic: [s1, s3],
                    in_sequence: true,
                    ..Distortion::new(Projection::Equidistant)
                };
                ([fx, fy], [cx, cy], bent)
            }
            ("SIMPLE_FISHEYE", &[f, cx, cy]) => ([f, f], [cx, cy], fisheye([0.0; 4])),
            ("FISHEYE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy], fisheye([0.0; 4])),
            ("SIMPLE_DIVISION", &[f, cx, cy, k]) => ([f, f], [cx, cy], self.fitted(path, [f, f, cx, cy], division(k))?),
            ("DIVISION", &[fx, fy, cx, cy, k]) => {
                ([fx, fy], [cx, cy], self.fitted(path, [fx, fy, cx, cy], division(k))?)
            }
            ("EUCM", &[fx, fy, cx, cy, alpha, beta]) => {
                ([fx, fy], [cx, cy], self.fitted(path, [fx, fy, cx, cy], eucm(alpha, beta))?)
            }
            ("EQUIRECTANGULAR", &[w, h]) if [w, h] != size.map(|side| side as f64) => {
                return Err(self.unsupported(path, "its parameters are not the width and height of its picture"));
            }
            ("EQUIRECTANGULAR", &[_, _]) => {
                let (front, camera) = PanoramaPart::front(size, camera_from_world);
                return Ok((camera, Some(front)));
            }
            // without an angle it is a pinhole
            ("FOV", &[fx, fy, cx, cy, 0.0]) => ([fx, fy], [cx, cy], perspective),
            ("FOV", &[fx, fy, cx, cy, omega]) => ([fx, fy], [cx, cy], Distortion::new(Projection::FieldOfView(omega))),
            (model, params) => {
                let Some((_, count)) = MODELS.iter().find(|(name, _)| *name == model) else {
                    return Err(self.unsupported(path, "it is unknown here"));
                };
                let what = format!("the number of parameters of camera {} ({model})", self.id);
                return Err(DatasetError::malformed(path, what, params.len(), count));
            }
        };
        let ([fx, fy], [cx, cy], [width, height], lens) = (focal, centre, size, lens(distortion));
        Ok((Camera { camera_from_world, fx, fy, cx, cy, width, height, near: 0.0, lens }, None))
    }

    fn unsupported(&self, path: &Path, reason: &'static str) -> DatasetError {
        let (camera, model) = (format!("camera {}", self.id), self.model.clone());
        DatasetError::CameraModel { path: path.to_owned(), camera, model, reason }
    }

    /// The distortion whose angles are those of `ray`, for a radius in focal lengths the distance from the axis and along it.
    fn fitted(
        &self,
        path: &Path,
        [fx, fy, cx, cy]: [f64; 4],
        ray: impl Fn(f64) -> Option<[f64; 2]>,
    ) -> Result<Distortion> {
        let across = cx.abs().max((self.width as f64 - cx).abs()) / fx;
        let along = cy.abs().max((self.height as f64 - cy).abs()) / fy;
        let reason = "its formula is too far from the others that are possible here";
        radial_fit::equidistant(across.hypot(along), MOST_ERROR_PX / fx.max(fy), ray)
            .ok_or_else(|| self.unsupported(path, reason))
    }
}

/// (x, y) / (1 + k r²) (Fitzgibbon).
fn division(k: f64) -> impl Fn(f64) -> Option<[f64; 2]> {
    move |radius| Some([radius, 1.0 + k * radius * radius])
}

/// The enhanced unified camera model (Khomutenko et al.).
fn eucm(alpha: f64, beta: f64) -> impl Fn(f64) -> Option<[f64; 2]> {
    move |radius| {
        let squared = beta * radius * radius;
        let root = 1.0 - (2.0 * alpha - 1.0) * squared;
        (root >= 0.0).then(|| [radius, (1.0 - alpha * alpha * squared) / (alpha * root.sqrt() + 1.0 - alpha)])
    }
}
