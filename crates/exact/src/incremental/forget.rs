//! Variables that are integrated out as time goes on: a fixed lag.

use super::tree::NONE;
use super::{Incremental, Piece, UpdateReport};
use crate::ExactError;
use sumprod_graph::{Factor, FactorGraph, VariableId};
use sumprod_messages::GaussianFamily;

impl Incremental {
    /// Integrates variables out: they keep their last values, and what they said of others stays as one quadratic.
    /// With all variables but the latest forgotten as time goes on, memory and time of an update are bounded but for what
    /// the graph itself holds.
    ///
    /// # Errors
    ///
    /// Where a handle is of another graph or not solved for yet, or a direction is free.
    pub fn forget<M: GaussianFamily, F: Factor<M>>(
        &mut self,
        graph: &FactorGraph<M, F>,
        variables: &[VariableId],
    ) -> Result<UpdateReport, ExactError> {
        for variable in variables {
            self.solved(*variable)?;
        }
        let leaving: Vec<u32> = variables.iter().map(|variable| variable.index() as u32).collect();
        self.with_problem(graph, |own, problem| {
            own.welcome(problem, &[])?;
            let report = own.solve(problem, Vec::new(), &leaving)?;
            own.release(&leaving);
            Ok(report)
        })
    }

    /// Takes forgotten variables out of the tree; the messages of their cliques become pieces.
    fn release(&mut self, leaving: &[u32]) {
        for &variable in leaving {
            self.forgotten[variable as usize] = true;
            for number in std::mem::take(&mut self.pieces_of[variable as usize]) {
                let gone = std::mem::take(&mut self.pieces[number as usize].quadratic.variables);
                self.pieces[number as usize] = Piece::default();
                for other in gone {
                    self.pieces_of[other as usize].retain(|&piece| piece != number);
                }
            }
        }
        let stays = |variable: &u32| !self.forgotten[*variable as usize];
        let mut cliques: Vec<u32> = leaving
            .iter()
            .map(|&variable| self.tree.clique_of[variable as usize])
            .filter(|&c| c != NONE)
            .collect();
        cliques.sort_unstable();
        cliques.dedup();
        let mut messages = Vec::new();
        for index in cliques {
            let message = self.tree.detach(index);
            // What goes to another forgotten clique is in that one's message.
            if !message.variables.is_empty() && message.variables.iter().all(stays) {
                messages.push(message);
            }
        }
        for message in messages {
            self.piece(None, message.variables.clone());
            if let Some(piece) = self.pieces.last_mut() {
                piece.quadratic = message;
            }
        }
    }
}
