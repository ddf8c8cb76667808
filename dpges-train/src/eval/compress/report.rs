//! The result of compression, in numbers and in words.

use std::collections::BTreeMap;
use std::fmt;

use dpges_core::Error;
use dpges_core::scene::{Quality, SceneData};
use serde::Serialize;

use super::Compressed;

/// Content of the file of `--json`.
#[derive(Debug, Serialize)]
pub struct Report {
    pub scene: String,
    pub out: String,
    pub bytes_before: usize,
    pub bytes_after: usize,
    /// Bytes before for each byte after.
    pub ratio: f64,
    pub bits: Quality,
    /// Attributes of the primitives, by name; those of sets without primitives are left out.
    pub attributes: BTreeMap<&'static str, Bits>,
    /// Absent if it was not measured.
    #[serde(flatten)]
    pub psnr: Option<Psnr>,
}

/// Bits per primitive that an attribute takes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bits {
    pub bits_before: f64,
    pub bits_after: f64,
}

/// PSNR against the photographs of a split, mean over the views, dB.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Psnr {
    pub dataset: String,
    /// `test` or `train`
    pub split: String,
    pub views: usize,
    pub psnr_before: f64,
    pub psnr_after: f64,
}

impl fmt::Display for Psnr {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { split, views, psnr_before, psnr_after, .. } = self;
        let change = psnr_after - psnr_before;
        write!(f, "{psnr_before:.2} dB → {psnr_after:.2} dB ({change:+.3} dB, mean of {views} views, split `{split}`)")
    }
}

impl Report {
    /// The report of `compressed`, made of `data`, which the file `scene` with the bytes `before` holds. Attributes of splats
    /// are compared with those of a scene file.
    pub fn new(
        [scene, out]: [String; 2],
        data: &SceneData,
        before: &[u8],
        compressed: &Compressed,
        psnr: Option<Psnr>,
    ) -> Result<Self, Error> {
        let after = &compressed.bytes;
        let plain = SceneData::stored_sizes(before, &scene)
            .or_else(|_| SceneData::stored_sizes(&data.to_bytes(scene.as_ref())?, &scene))?;
        let sizes = plain.into_iter().zip(SceneData::stored_sizes(after, &out)?);
        let attributes = sizes.filter_map(|((name, before), (_, after))| {
            let primitives = match name.split_once('.')? {
                ("surfels", _) => data.surfels.len(),
                _ => data.gaussians.len(),
            };
            let bits = |bytes: usize| 8.0 * bytes as f64 / primitives as f64;
            (primitives > 0).then(|| (name, Bits { bits_before: bits(before), bits_after: bits(after) }))
        });
        Ok(Self {
            attributes: attributes.collect(),
            bytes_before: before.len(),
            bytes_after: after.len(),
            ratio: before.len() as f64 / after.len() as f64,
            bits: compressed.quality,
            scene,
            out,
            psnr,
        })
    }

    /// For people. `not_measured` says why there is no PSNR.
    pub fn rows(&self, not_measured: &str) -> Vec<(&str, String)> {
        let megabytes = |bytes: usize| bytes as f64 / 1e6;
        let (before, after, ratio) = (megabytes(self.bytes_before), megabytes(self.bytes_after), self.ratio);
        let bits: Vec<String> =
            Quality::NAMES.iter().zip(self.bits.list()).map(|(name, bits)| format!("{name} {bits}")).collect();
        let mut rows = vec![
            ("file", self.out.clone()),
            ("size", format!("{before:.2} MB → {after:.2} MB, {ratio:.2} times smaller")),
            ("bits per number", bits.join(", ")),
        ];
        rows.extend(self.attributes.iter().map(|(&name, Bits { bits_before, bits_after })| {
            (name, format!("{bits_before:.1} → {bits_after:.1} bits per primitive"))
        }));
        let psnr = match &self.psnr {
            Some(psnr) => psnr.to_string(),
            None => format!("not measured: {not_measured}"),
        };
        rows.push(("PSNR", psnr));
        rows
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{ColourModel, GaussianData, SceneInfo, SurfelData};

    use super::*;

    #[test]
    fn the_report_counts_bits_per_primitive() {
        let model = ColourModel::SphericalBeta { lobes: 1 };
        let data = SceneData {
            info: SceneInfo { colour_model: model, ..SceneInfo::default() },
            surfels: SurfelData::default(),
            gaussians: GaussianData::neutral(model, 1000),
            environment: None,
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.safetensors");
        data.save(&path).unwrap();
        let before = std::fs::read(&path).unwrap();
        let compressed = Compressed::new(&data, &Quality::LOW, "small".as_ref()).unwrap();
        let names = ["scene", "small"].map(str::to_owned);
        let psnr =
            Psnr { dataset: "builtin".into(), split: "test".into(), views: 6, psnr_before: 30.0, psnr_after: 29.96 };
        let report = Report::new(names.clone(), &data, &before, &compressed, Some(psnr)).unwrap();
        assert_eq!((report.bytes_before, report.bytes_after), (before.len(), compressed.bytes.len()));
        let positions = report.attributes["gaussians.positions"];
        assert!(positions.bits_before == 96.0 && positions.bits_after < 10.0);
        assert_eq!(report.attributes["gaussians.colour.detail"].bits_before, 8.0 * 25.0);
        assert!(report.attributes.keys().all(|name| name.starts_with("gaussians.")), "there are no surfels");
        let text = format!("{:?}", report.rows(""));
        assert!(text.contains("-0.040 dB") && text.contains("detail 5") && text.contains("96.0 → "), "{text}");
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!((&json["psnr_after"], &json["bits"]["detail"]), (&29.96.into(), &5.into()));

        let report = Report::new(names, &data, b"ply of splats", &compressed, None).unwrap();
        assert_eq!((report.bytes_before, report.attributes["gaussians.positions"].bits_before), (13, 96.0));
        assert!(format!("{:?}", report.rows("no photographs")).contains("not measured: no photographs"));
        assert!(serde_json::to_value(&report).unwrap().get("psnr_after").is_none());
    }
}
