//! The golden case of Student's t kernels, and the coefficients of their relocation (SSS).

use std::path::Path;

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::ops::blend::{BlendOptions, Form, blend};
use dpges_core::scene::{Colour, ColourModel, Gaussians};
use dpges_core::testing::compare::relative_l2;
use dpges_core::testing::golden::values;
use glam::{DMat3, DVec3};
use safetensors::SafeTensors;

const ATTRIBUTES: [(&str, usize); 6] = [
    ("positions", 3),
    ("quaternions", 4),
    ("log_scales", 3),
    ("opacities", 1),
    ("degrees_of_freedom", 1),
    ("colours", 3),
];

struct Case {
    bytes: Vec<u8>,
}

impl Case {
    fn load() -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("golden_students/students.safetensors");
        Self { bytes: std::fs::read(path).unwrap() }
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        let file = SafeTensors::deserialize(&self.bytes).unwrap();
        let tensor = file.tensor(name).unwrap_or_else(|error| panic!("{name}: {error}"));
        tensor.data().as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()
    }

    fn camera(&self) -> Camera {
        let (_, header) = SafeTensors::read_metadata(&self.bytes).unwrap();
        let metadata = header.metadata().clone().unwrap();
        let number = |key: &str| metadata[key].parse::<f64>().unwrap();
        let intrinsics = self.numbers("camera.intrinsics");
        Camera {
            camera_from_world: CameraFromWorld {
                rotation: DMat3::from_cols_slice(&self.numbers("camera.rotation")).transpose(),
                translation: DVec3::from_slice(&self.numbers("camera.translation")),
            },
            fx: intrinsics[0],
            fy: intrinsics[1],
            cx: intrinsics[2],
            cy: intrinsics[3],
            width: number("width") as usize,
            height: number("height") as usize,
            near: number("near"),
            lens: None,
        }
    }

    /// How far every output and every gradient is from its golden values, relative L2.
    fn compare(&self, device: &Device, dtype: DType) -> Vec<(String, f64)> {
        let device = device.clone().autodiff();
        let leaf = |(name, width): (&str, usize)| {
            let numbers = self.numbers(&format!("students.{name}"));
            let shape = [numbers.len() / width, width];
            let data = TensorData::new(numbers, shape).convert_dtype(dtype);
            Tensor::<2>::from_data(data, (&device, dtype)).require_grad()
        };
        let leaves = ATTRIBUTES.map(leaf);
        let [positions, quaternions, log_scales, opacities, degrees, colours] = leaves.clone();
        let nothing = TensorData::new(Vec::<f64>::new(), [positions.dims()[0], 0]).convert_dtype(dtype);
        let detail = Tensor::from_data(nothing, (&device, dtype));
        let students = Gaussians {
            positions,
            quaternions,
            log_scales,
            opacities,
            opacity_base: detail.clone(),
            opacity_detail: detail.clone(),
            colour: Colour::new(ColourModel::SphericalBeta { lobes: 0 }, colours.clone(), detail),
            degrees_of_freedom: Some(degrees),
        };
        let camera = self.camera();
        let options = BlendOptions { form: Form::Students, max_alpha: 0.99, ..BlendOptions::default() };
        let found = blend(&students, &colours, None, &camera, &options).unwrap();
        // planes to the order of the file
        let mut pairs = vec![
            ("out.colour".to_owned(), values(&found.colour.clone().permute([1, 2, 0]))),
            ("out.alpha".to_owned(), values(&found.alpha)),
        ];
        let upstream = TensorData::new(self.numbers("upstream"), [camera.height, camera.width, 4]).convert_dtype(dtype);
        let upstream = Tensor::<3>::from_data(upstream, (&device, dtype)).permute([2, 0, 1]);
        let planes = Tensor::cat(vec![found.colour, found.alpha], 0);
        let gradients = (planes * upstream).sum().backward();
        for ((name, _), leaf) in ATTRIBUTES.iter().zip(&leaves) {
            pairs.push((format!("grad.{name}"), values(&leaf.grad(&gradients).unwrap())));
        }
        pairs.into_iter().map(|(name, found)| (name.clone(), relative_l2(&found, &self.numbers(&name)))).collect()
    }
}

/// Checks pictures and gradients on `device`.
pub fn check(device: &Device, dtype: DType) {
    let tolerance = if dtype == DType::F64 { 1e-9 } else { 2e-4 };
    let distances = Case::load().compare(device, dtype);
    let (name, worst) = distances.iter().max_by(|a, b| a.1.total_cmp(&b.1)).expect("tensors were compared");
    println!("students {dtype:?}: {} tensors, worst {name} {worst:.2e}", distances.len());
    let far: Vec<_> = distances.iter().filter(|(_, distance)| distance.is_nan() || *distance > tolerance).collect();
    assert!(distances.len() == 8 && far.is_empty(), "{far:?}");
}

#[test]
fn cpus_agree_with_the_specification() {
    for device in [crate::devices::ndarray(), crate::devices::flex()] {
        for dtype in [DType::F64, DType::F32] {
            check(&device, dtype);
        }
    }
}

/// Computed by mpmath from the published double sum.
#[test]
fn coefficients_of_relocation_are_those_of_the_published_sum() {
    let rows = Case::load().numbers("relocation");
    assert_eq!(rows.len(), 5 * 100);
    for row in rows.as_chunks::<5>().0 {
        let [opacity, copies, degrees, shared, factor] = *row;
        let (found, found_factor) = dpges_train::refine::sharing::share_out_students(opacity, copies as usize, degrees);
        // opacities are clamped afterwards
        let expected = shared.abs().max(0.005).copysign(shared);
        assert!((found - expected).abs() < 1e-12, "{row:?}: {found}");
        assert!((found_factor / factor - 1.0).abs() < 1e-9, "{row:?}: {found_factor}");
    }
}
