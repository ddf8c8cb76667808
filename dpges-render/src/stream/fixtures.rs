//! Forests and cameras for tests.

use std::path::Path;

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::lod::{Cell, INDEX, Index, Part};
use dpges_core::scene::{EnvironmentData, Quality, SceneData, SceneInfo};
use glam::DVec3;

use crate::fixtures::{neutral, pinhole};

/// Primitives of every cell of [`forest`].
pub const PRIMITIVES: usize = 100;

/// A camera of 100 × 100 px at `eye` that looks along z.
pub fn camera(eye: [f64; 3]) -> Camera {
    let eye = DVec3::from(eye);
    pinhole(CameraFromWorld::look_at(eye, eye + DVec3::Z, DVec3::NEG_Y), 100.0, [100, 100])
}

/// `roots` trees of `levels` below their roots, beside each other along x: of two children each, in halves of their
/// parent's box, with primitives half as wide.
pub fn forest(roots: usize, levels: u32) -> Index {
    let mut index = Index::new(SceneInfo::default());
    let of = |level, min, max, parent| Cell {
        level,
        min,
        max,
        parent,
        children: Vec::new(),
        part: Part { file: "cells.pack".to_owned(), offset: 0, bytes: 1 },
        surfels: PRIMITIVES / 10,
        gaussians: PRIMITIVES - PRIMITIVES / 10,
        size: 0.05 * 0.5f32.powi((levels - level) as i32),
    };
    for root in 0..roots {
        let left = 2.0 * root as f32 - roots as f32;
        index.cells.push(of(levels, [left, -1.0, -1.0], [left + 2.0, 1.0, 1.0], None));
    }
    let mut at = 0;
    while at < index.cells.len() {
        let Cell { level, min, max, .. } = index.cells[at];
        if level > 0 {
            let axis = (levels - level) as usize % 3;
            let middle = 0.5 * (min[axis] + max[axis]);
            for half in 0..2 {
                let (mut low, mut high) = (min, max);
                if half == 0 {
                    high[axis] = middle
                } else {
                    low[axis] = middle
                }
                let child = index.cells.len();
                index.cells[at].children.push(child);
                index.cells.push(of(level - 1, low, high, Some(at)));
            }
        }
        at += 1;
    }
    index
}

/// Writes a scene in levels of detail to `folder`: `cell(&index, i)` is the scene of cell i, with the settings of the index.
pub fn write(folder: &Path, mut index: Index, cell: impl Fn(&Index, usize) -> SceneData) -> Index {
    let mut pack = Vec::new();
    for at in 0..index.cells.len() {
        let scene = cell(&index, at);
        let bytes = scene.to_compressed(&Quality::HIGH, "cell".as_ref()).unwrap();
        let of = &mut index.cells[at];
        of.part = Part { file: "cells.pack".to_owned(), offset: pack.len() as u64, bytes: bytes.len() as u64 };
        (of.surfels, of.gaussians) = (scene.surfels.len(), scene.gaussians.len());
        pack.extend(bytes);
    }
    let mut sky = neutral(index.settings.clone(), [0, 0]);
    sky.environment =
        Some(EnvironmentData { coefficients: [[0.2, 0.5, 1.0], [0.1, -0.1, 0.2], [0.0; 3], [0.0; 3]].concat() });
    let bytes = sky.to_compressed(&Quality::HIGH, "sky".as_ref()).unwrap();
    index.sky = Some(Part { file: "base.safetensors".to_owned(), offset: 0, bytes: bytes.len() as u64 });
    std::fs::write(folder.join("base.safetensors"), bytes).unwrap();
    std::fs::write(folder.join("cells.pack"), pack).unwrap();
    std::fs::write(folder.join(INDEX), serde_json::to_vec(&index).unwrap()).unwrap();
    index
}

/// `surfels` and `gaussians` of all colours, turned at random, in the box of `cell`.
pub fn filled(index: &Index, cell: usize, [surfels, gaussians]: [usize; 2]) -> SceneData {
    let (of, mut random) = (&index.cells[cell], Random(cell as u64 + 1));
    let mut scene = neutral(index.settings.clone(), [surfels, gaussians]);
    let mut numbers = |count: usize, low: f64, high: f64| -> Vec<f32> {
        (0..count).map(|_| (low + (high - low) * random.next()) as f32).collect()
    };
    let places = |unit: Vec<f32>| -> Vec<f32> {
        let (rows, _) = unit.as_chunks::<3>();
        let place =
            |row: &[f32; 3]| [0, 1, 2].map(|axis: usize| of.min[axis] + row[axis] * (of.max[axis] - of.min[axis]));
        rows.iter().flat_map(place).collect()
    };
    scene.surfels.positions = places(numbers(3 * surfels, 0.0, 1.0));
    scene.surfels.quaternions = numbers(4 * surfels, -1.0, 1.0);
    scene.surfels.log_scales = numbers(2 * surfels, -3.5, -2.5);
    scene.surfels.colour.base = numbers(3 * surfels, -1.5, 1.5);
    scene.gaussians.positions = places(numbers(3 * gaussians, 0.0, 1.0));
    scene.gaussians.quaternions = numbers(4 * gaussians, -1.0, 1.0);
    scene.gaussians.log_scales = numbers(3 * gaussians, -4.0, -2.5);
    scene.gaussians.opacities = numbers(gaussians, 0.01, 1.5);
    scene.gaussians.colour.base = numbers(3 * gaussians, -1.5, 1.5);
    scene
}

/// Random numbers from 0 to 1 (an LCG of Knuth's).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}
