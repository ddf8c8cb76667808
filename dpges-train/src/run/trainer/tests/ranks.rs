use burn::tensor::Tensor;
use dpges_core::testing::ranks::on_ranks;

use super::*;
use crate::device::place::Place;
use crate::run::TrainError;

#[test]
fn what_is_not_finite_on_one_rank_holds_all_back() {
    on_ranks(2, |ranks| {
        let place = Place { device: device(), ranks: ranks.clone() };
        let mut trainer = Trainer::new(config(&["train.steps=20"]), dataset(), place).unwrap();
        for _ in 0..3 {
            trainer.step().unwrap();
        }
        let mut before = trainer.checkpoint();
        if ranks.rank() == 1 {
            trainer.context.config.train.lambda_dssim = 1e39;
        }
        let error = trainer.step().unwrap_err();
        match error {
            TrainError::Loss { step: 4, .. } => assert_eq!(ranks.rank(), 1),
            TrainError::Step { step: 4, ref source, .. } => {
                assert!(ranks.is_first() && source.to_string().contains("another rank"), "{error}");
            }
            other => panic!("{other}"),
        }
        before.state.config = trainer.config().clone();
        let after = trainer.checkpoint();
        assert!(after == before || after.state.refined);
    });
}

#[test]
fn a_rank_that_has_something_else_is_named() {
    let errors = on_ranks(3, |ranks| {
        let place = Place { device: device(), ranks: ranks.clone() };
        let mut trainer = Trainer::new(config(&["train.steps=20"]), dataset(), place).unwrap();
        trainer.step().unwrap();
        trainer.check_ranks().unwrap();
        if ranks.rank() == 2 {
            let positions = &mut trainer.stage.parameters().surfels.columns.positions;
            let moved: Tensor<2> = positions.raw() + 1e-3;
            positions.set_tensor(moved);
        }
        trainer.check_ranks().unwrap_err().to_string()
    });
    assert!(errors.iter().all(|error| error.contains("step 1: rank 2")), "{errors:?}");
}
