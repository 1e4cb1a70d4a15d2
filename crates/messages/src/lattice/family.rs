//! How Gaussian rules read and write these messages.

use super::product::to_gaussian;
use super::{LatticeForm, LatticeMessage, LatticeValue};
use crate::{Gaussian, GaussianFamily, GaussianForm};
use sumprod_graph::MessageError;

impl GaussianFamily for LatticeMessage {
    fn gaussian_form(form: &LatticeForm) -> GaussianForm {
        match form {
            LatticeForm::Gaussian(form) => *form,
            LatticeForm::Lattice { .. } => GaussianForm::default(),
        }
    }

    fn dimension(&self) -> usize {
        2
    }

    fn read_information(&self, information: &mut [f64], vector: &mut [f64]) -> Result<f64, MessageError> {
        match &self.value {
            LatticeValue::Gaussian(gaussian) => gaussian.read_information(information, vector),
            LatticeValue::Lattice(lattice) => {
                let (gaussian, loss) = to_gaussian(lattice)?;
                gaussian.read_information(information, vector)?;
                Ok(loss)
            }
        }
    }

    fn write_information(
        &mut self,
        _like: &Self,
        information: &[f64],
        vector: &[f64],
        loss: f64,
    ) -> Result<(), MessageError> {
        let mut gaussian = Gaussian::default();
        gaussian.write_information(&Gaussian::default(), information, vector, loss)?;
        self.value = LatticeValue::Gaussian(gaussian);
        self.loss = (loss != 0.0).then_some(loss);
        Ok(())
    }
}
