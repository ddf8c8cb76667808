//! The memory that runs of one process report.

use std::hint::black_box;

use super::fixtures::{config, dataset, device};
use super::folder::read_json;
use super::*;
use crate::eval::EvalReport;

/// Bytes that were in use before a run; no test of this process needs as many.
const EARLIER: usize = 1 << 30;

#[test]
fn a_run_reports_its_own_peak_and_not_that_of_what_was_done_before() {
    drop(black_box(vec![1u8; EARLIER]));
    let folder = tempfile::tempdir().unwrap();
    let out = RunFolder::new(folder.path());
    let run = Run::new(config(&["train.steps=2", "refine.budget=300"]), dataset(), device()).unwrap();
    let mut run = run.write_to(out.clone(), Origin::new("builtin", "cpu")).unwrap();
    run.train(&mut ()).unwrap();
    let report: EvalReport = read_json(&out.evaluation()).unwrap();
    let is_known = PeakMemory::start().bytes().is_some();
    assert_eq!(report.peak_memory_bytes.is_some(), is_known);
    assert!(report.peak_memory_bytes.is_none_or(|bytes| bytes < EARLIER as u64), "{:?}", report.peak_memory_bytes);
}
