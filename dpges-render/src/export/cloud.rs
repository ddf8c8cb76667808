//! Splats as other programs know them: ellipsoids that are sorted by depth and blended one over the other (3DGS).

use dpges_core::scene::{ColourData, ColourModel, GaussianData, Rendering, SceneData, SceneInfo, SurfelData};
use glam::{DMat3, DQuat};

use super::harmonics::{HarmonicsRotation, coefficient_count};

/// N ellipsoids that are sorted by depth and blended one over the other (3DGS).
///
/// [`flatten`](super::flatten()) makes it of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatCloud {
    /// `[N]` centres, world units.
    pub positions: Vec<[f32; 3]>,
    /// `[N]` unit quaternions (w, x, y, z).
    pub quaternions: Vec<[f32; 4]>,
    /// `[N]` natural logarithms of the standard deviations along the columns of the rotation, world units.
    pub log_scales: Vec<[f32; 3]>,
    /// `[N]` between 0 and 1, neither included.
    pub opacities: Vec<f32>,
    /// Degree of the harmonics, 0 to 3.
    pub degree: usize,
    /// [N, (degree + 1)², 3] coefficients of spherical harmonics: those of a splat together, red, green and blue of one
    /// together. A colour is `0.5 + Σ k_i Y_i`.
    pub harmonics: Vec<f32>,
    /// The scene's: where it is, what is up, and the filter that the splats are made for. Rendered as discs, the last axis
    /// does not matter.
    pub info: SceneInfo,
}

impl SplatCloud {
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Numbers per splat in [`harmonics`](Self::harmonics).
    pub fn harmonics_len(&self) -> usize {
        3 * coefficient_count(self.degree)
    }

    /// Coefficients of splat `row`, red, green and blue of each.
    pub fn harmonics_of(&self, row: usize) -> &[[f32; 3]] {
        let width = self.harmonics_len();
        self.harmonics[row * width..(row + 1) * width].as_chunks::<3>().0
    }

    /// The splats of `rows`, in their order.
    #[must_use]
    pub fn select(&self, rows: &[usize]) -> Self {
        Self {
            positions: rows.iter().map(|&row| self.positions[row]).collect(),
            quaternions: rows.iter().map(|&row| self.quaternions[row]).collect(),
            log_scales: rows.iter().map(|&row| self.log_scales[row]).collect(),
            opacities: rows.iter().map(|&row| self.opacities[row]).collect(),
            degree: self.degree,
            harmonics: rows.iter().flat_map(|&row| self.harmonics_of(row).as_flattened()).copied().collect(),
            info: self.info.clone(),
        }
    }

    /// The cloud as a scene of [`Rendering::Ellipsoids`] or discs, which our own sorted blending renders.
    pub fn to_scene(&self) -> SceneData {
        let rendering = if self.info.rendering == Rendering::Discs { Rendering::Discs } else { Rendering::Ellipsoids };
        let model = ColourModel::SphericalHarmonics { degree: self.degree };
        let rows = || (0..self.len()).map(|row| self.harmonics_of(row));
        let colour = ColourData::new(
            model,
            rows().flat_map(|k| k[0]).collect(),
            rows().flat_map(|k| k[1..].as_flattened()).copied().collect(),
        );
        SceneData {
            info: SceneInfo { colour_model: model, rendering, ..self.info.clone() },
            surfels: SurfelData::neutral(model, 0),
            gaussians: GaussianData {
                positions: self.positions.as_flattened().to_vec(),
                quaternions: self.quaternions.as_flattened().to_vec(),
                log_scales: self.log_scales.as_flattened().to_vec(),
                opacities: self.opacities.clone(),
                colour,
                ..GaussianData::default()
            },
            environment: None,
        }
    }

    /// The cloud in coordinates that are `factor` times as large.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        if factor != 1.0 {
            let grown = |x: &mut f32| *x = (factor * f64::from(*x)) as f32;
            self.positions.as_flattened_mut().iter_mut().for_each(grown);
            self.log_scales.as_flattened_mut().iter_mut().for_each(|scale| *scale += factor.ln() as f32);
            self.info = self.info.scaled(factor);
        }
        self
    }

    /// The cloud in the world that `rotation` makes of the old one: centres, axes and colours. The
    /// [`info`](Self::info) stays.
    #[must_use]
    pub fn rotated(&self, rotation: DMat3) -> Self {
        if rotation == DMat3::IDENTITY {
            return self.clone();
        }
        let (turn, colours) = (DQuat::from_mat3(&rotation), HarmonicsRotation::new(rotation));
        let mut rotated = self.clone();
        for position in &mut rotated.positions {
            *position = (rotation * glam::Vec3::from(*position).as_dvec3()).as_vec3().to_array();
        }
        for quaternion in &mut rotated.quaternions {
            let [w, x, y, z] = quaternion.map(f64::from);
            let DQuat { x, y, z, w } = turn * DQuat::from_xyzw(x, y, z, w);
            *quaternion = [w, x, y, z].map(|component| component as f32);
        }
        let width = self.harmonics_len();
        rotated.harmonics.chunks_exact_mut(width).for_each(|coefficients| colours.apply(coefficients));
        rotated
    }
}

#[cfg(test)]
pub(super) mod tests {
    use glam::DVec3;

    use super::super::harmonics::evaluate;
    use super::*;

    /// `count` different splats with harmonics of `degree`.
    pub fn sample(count: usize, degree: usize) -> SplatCloud {
        let value = |row: usize, column: usize| ((row * 31 + column * 17 + 3) as f32 * 0.37).sin();
        let rows = || 0..count;
        let unit = |row| {
            let q: [f32; 4] = std::array::from_fn(|i| value(row, 10 + i));
            let length = q.iter().map(|c| c * c).sum::<f32>().sqrt();
            q.map(|component| component / length)
        };
        let width = 3 * coefficient_count(degree);
        SplatCloud {
            positions: rows().map(|row| std::array::from_fn(|i| 3.0 * value(row, i))).collect(),
            quaternions: rows().map(unit).collect(),
            log_scales: rows().map(|row| std::array::from_fn(|i| -4.0 + 1.5 * value(row, 4 + i))).collect(),
            opacities: rows().map(|row| 0.5 + 0.45 * value(row, 8)).collect(),
            degree,
            harmonics: rows().flat_map(|row| (0..width).map(move |i| 0.6 * value(row, 20 + i))).collect(),
            info: SceneInfo {
                offset: [100.0, -20.5, 3.0],
                up: Some([0.0, 1.0, 0.0]),
                colour_model: ColourModel::SphericalHarmonics { degree },
                rendering: Rendering::Ellipsoids,
                ..SceneInfo::default()
            },
        }
    }

    #[test]
    fn a_scaled_cloud_has_larger_places_and_sizes_and_says_so() {
        let mut cloud = sample(2, 1);
        cloud.info.metres_per_unit = Some(0.5);
        let scaled = cloud.clone().scaled(0.5);
        assert_eq!(scaled.positions[1][2], 0.5 * cloud.positions[1][2]);
        assert!((scaled.log_scales[1][0].exp() - 0.5 * cloud.log_scales[1][0].exp()).abs() < 1e-6);
        assert_eq!((scaled.info.metres_per_unit, scaled.info.offset), (Some(1.0), [50.0, -10.25, 1.5]));
        assert_eq!((&scaled.harmonics, &scaled.opacities), (&cloud.harmonics, &cloud.opacities));
        assert_eq!(cloud.clone().scaled(1.0), cloud);
    }

    #[test]
    fn the_scene_of_a_cloud_has_its_numbers() {
        let cloud = sample(3, 2);
        let scene = cloud.to_scene();
        assert_eq!(scene.info.rendering, Rendering::Ellipsoids);
        assert_eq!((scene.gaussians.len(), scene.surfels.len()), (3, 0));
        assert_eq!(scene.gaussians.colour.detail.len(), 3 * 24);
        assert_eq!(scene.gaussians.colour.base[3..6], cloud.harmonics[27..30]);
        assert_eq!(scene.gaussians.colour.detail[24..27], cloud.harmonics[30..33]);
        let file = tempfile::NamedTempFile::new().unwrap();
        scene.save(file.path()).unwrap();
        assert_eq!(SceneData::load(file.path()).unwrap(), scene);
    }

    #[test]
    fn rotation_takes_centres_axes_and_colours_along() {
        let (cloud, rotation) = (sample(4, 3), DMat3::from_axis_angle(DVec3::new(0.48, 0.6, -0.64), 0.9));
        let rotated = cloud.rotated(rotation);
        let axis = |q: [f32; 4]| {
            let [w, x, y, z] = q.map(f64::from);
            DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()).col(0)
        };
        let point = |p: [f32; 3]| glam::Vec3::from(p).as_dvec3();
        for row in 0..4 {
            assert!((rotation * point(cloud.positions[row]) - point(rotated.positions[row])).length() < 1e-6);
            assert!((rotation * axis(cloud.quaternions[row]) - axis(rotated.quaternions[row])).length() < 1e-6);
            let direction = DVec3::new(0.6, 0.0, 0.8);
            let [before, after] = [(&cloud, direction), (&rotated, rotation * direction)]
                .map(|(cloud, direction)| evaluate(cloud.harmonics_of(row).as_flattened(), direction));
            assert!(before.iter().zip(after).all(|(a, b)| (a - b).abs() < 1e-5));
        }
        assert_eq!(cloud.rotated(DMat3::IDENTITY), cloud);
    }
}
