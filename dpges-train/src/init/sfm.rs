//! Initialisation from the points of structure from motion. The neighbours of a point determine its normal, and the
//! cameras that saw it the sign of the normal.

use std::collections::HashMap;

use glam::DVec3;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::placement::{OrientedPoints, draw_rows};
use crate::dataset::PointCloud;
use crate::dataset::neighbours::{Neighbour, nearest};

/// Neighbours that determine a normal.
const NEIGHBOURS: usize = 16;
/// Below this ratio of the middle to the largest eigenvalue, points count as collinear and have no normal.
const LINE: f64 = 1e-6;

/// At most `max_points` finite points at distinct positions, drawn at random, in their order. Points at the same
/// position are merged into the first of them, which is then seen by all views that see any of them.
pub fn usable_points(points: &PointCloud, max_points: usize, rng: &mut ChaCha8Rng) -> PointCloud {
    let mut row_at: HashMap<[u32; 3], usize> = HashMap::with_capacity(points.positions.len());
    let mut usable = PointCloud::default();
    // of each usable point its row in `points`, and the other rows at the same position
    let (mut first, mut twins): (Vec<u32>, Vec<(u32, u32)>) = (Vec::new(), Vec::new());
    for (row, (position, colour)) in points.positions.iter().zip(&points.colours).enumerate() {
        if !position.iter().chain(colour).all(|x| x.is_finite()) {
            continue;
        }
        let new_row = usable.positions.len();
        // Adding zero turns -0 into 0, so that equal points have equal bits.
        match *row_at.entry(position.map(|x| (x + 0.0).to_bits())).or_insert(new_row) {
            at if at == new_row => {
                usable.positions.push(*position);
                usable.colours.push(colour.map(|c| c.clamp(0.0, 1.0)));
                first.push(row as u32);
            }
            at => twins.push((at as u32, row as u32)),
        }
    }
    twins.sort_unstable();
    let seen_by = |at: usize| {
        let from = twins.partition_point(|&(of, _)| (of as usize) < at);
        let others = twins[from..].iter().take_while(move |&&(of, _)| of as usize == at).map(|&(_, row)| row);
        [first[at]].into_iter().chain(others).flat_map(|row| points.seen_by.of(row as usize).iter().copied())
    };
    let rows = draw_rows(usable.positions.len(), max_points, rng);
    PointCloud {
        positions: rows.iter().map(|&row| usable.positions[row]).collect(),
        colours: rows.iter().map(|&row| usable.colours[row]).collect(),
        seen_by: rows.iter().map(|&row| seen_by(row)).collect(),
    }
}

/// Gives every point the normal of the plane through its 16 nearest neighbours, towards the mean of the
/// `camera_centres` (world units) that saw the point, or of all cameras if that is unknown. If the points span no
/// plane, the normal points at that mean.
pub fn orient(points: PointCloud, camera_centres: &[DVec3]) -> OrientedPoints {
    let all: Vec<u32> = (0..camera_centres.len() as u32).collect();
    let normal = |(row, around): (usize, &Vec<Neighbour>)| {
        let known = Some(points.seen_by.of(row)).filter(|seen| !seen.is_empty()).unwrap_or(&all);
        let centres = known.iter().filter_map(|&view| camera_centres.get(view as usize));
        let (sum, count) = centres.fold((DVec3::ZERO, 0), |(sum, count), centre| (sum + *centre, count + 1));
        let towards = sum / f64::from(count.max(1)) - point(points.positions[row]);
        match plane_normal(&points.positions, row, around) {
            Some(normal) if normal.dot(towards) < 0.0 => -normal,
            Some(normal) => normal,
            None => towards.try_normalize().unwrap_or(DVec3::Z),
        }
    };
    let around = nearest(&points.positions, NEIGHBOURS);
    let normals = around.par_iter().enumerate().map(normal).collect();
    OrientedPoints { positions: points.positions, colours: points.colours, normals }
}

/// The direction in which a point and its neighbours spread least; `None` if they span no plane.
fn plane_normal(positions: &[[f32; 3]], row: usize, around: &[Neighbour]) -> Option<DVec3> {
    let patch = || around.iter().map(|&(row, _)| row as usize).chain([row]).map(|row| point(positions[row]));
    let mean = patch().sum::<DVec3>() / (around.len() + 1) as f64;
    let covariance = patch().fold(Matrix3::zeros(), |sum, p| {
        let d = Vector3::from((p - mean).to_array());
        sum + d * d.transpose()
    });
    let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(covariance);
    let mut ascending = [0, 1, 2];
    ascending.sort_by(|&a, &b| eigenvalues[a].total_cmp(&eigenvalues[b]));
    let [smallest, middle, largest] = ascending;
    (eigenvalues[middle] > LINE * eigenvalues[largest])
        .then(|| DVec3::from_slice(eigenvectors.column(smallest).as_slice()).normalize())
}

fn point(position: [f32; 3]) -> DVec3 {
    DVec3::from_array(position.map(f64::from))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::dataset::Tracks;

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(2)
    }

    fn cloud(positions: Vec<[f32; 3]>) -> PointCloud {
        let n = positions.len();
        PointCloud { positions, colours: vec![[0.5; 3]; n], seen_by: Tracks::default() }
    }

    #[test]
    fn points_on_a_sphere_look_outwards_to_the_camera_that_saw_them() {
        let mut rng = rng();
        let mut draw = || loop {
            let p = DVec3::from_array([0; 3].map(|_| rng.random::<f64>() * 2.0 - 1.0));
            if (0.1..1.0).contains(&p.length()) {
                return p.normalize();
            }
        };
        let on_sphere: Vec<DVec3> = (0..4000).map(|_| draw()).collect();
        let centres = [4.0 * DVec3::X, -4.0 * DVec3::X];
        let mut points = cloud(on_sphere.iter().map(|p| p.as_vec3().to_array()).collect());
        points.seen_by = on_sphere.iter().map(|p| [u32::from(p.x < 0.0)]).collect();
        let oriented = orient(points, &centres);
        let facing_camera = on_sphere.iter().zip(&oriented.normals).filter(|(p, _)| p.x.abs() > 0.4);
        assert!(facing_camera.clone().count() > 1000);
        assert!(facing_camera.clone().all(|(p, normal)| p.dot(*normal) > 0.9));
    }

    #[test]
    fn few_points_and_lines_look_at_the_cameras() {
        let eye = DVec3::new(0.0, 5.0, 0.0);
        for count in 1..=20 {
            let oriented = orient(cloud((0..count).map(|i| [0.0, 0.0, i as f32]).collect()), &[eye]);
            assert_eq!(oriented.positions.len(), count);
            for (position, normal) in oriented.positions.iter().zip(&oriented.normals) {
                assert!((*normal - (eye - point(*position)).normalize()).length() < 1e-9, "{count}");
            }
        }
        let triangle = cloud(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
        assert!(orient(triangle, &[eye]).normals.iter().all(|normal| normal.distance(DVec3::Y) < 1e-9));
        assert_eq!(orient(cloud(vec![[0.0; 3]]), &[]).normals, [DVec3::Z]);
        assert!(orient(cloud(vec![]), &[eye]).positions.is_empty());
    }

    #[test]
    fn unusable_points_are_left_out_and_twins_become_one() {
        let mut points = cloud(vec![[0.0; 3], [f32::NAN, 0.0, 0.0], [1.0; 3], [-0.0; 3], [f32::INFINITY; 3], [2.0; 3]]);
        points.seen_by = [vec![3], vec![], vec![1], vec![0, 3], vec![], vec![]].into_iter().collect();
        points.colours[2] = [2.0, -1.0, 0.5];
        points.colours[5] = [f32::NAN; 3];
        let usable = usable_points(&points, 100, &mut rng());
        assert_eq!(usable.positions, [[0.0; 3], [1.0; 3]]);
        assert_eq!(usable.seen_by, [vec![0, 3], vec![1]].into_iter().collect());
        assert_eq!(usable.colours[1], [1.0, 0.0, 0.5]);
        assert_eq!(usable_points(&points, 1, &mut rng()).positions.len(), 1);
    }
}
