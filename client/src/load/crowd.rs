//! The viewers of one overlap, together.

use std::time::Duration;

use skycell_protocol::message::Hello;
use skycell_protocol::{QualityChoice, ViewerId};
use tokio::sync::{oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

use super::viewer::{Phase, Place, ViewerFigures, run_viewer};
use super::{LoadError, LoadOptions};
use crate::{ConnectionError, ServerAddress};

type ViewerTask = JoinHandle<Result<ViewerFigures, ConnectionError>>;

/// Connected viewers. Dropping the crowd cuts their connections.
pub(super) struct Crowd {
    phase: watch::Sender<Phase>,
    tasks: Vec<ViewerTask>,
    ids: Vec<ViewerId>,
}

impl Crowd {
    /// Connects all viewers of an overlap at once.
    pub(super) async fn join(
        address: &ServerAddress,
        options: &LoadOptions,
        overlap: f64,
    ) -> Result<Self, LoadError> {
        let (phase, _) = watch::channel(Phase::Hold);
        let mut crowd = Self {
            phase,
            tasks: Vec::new(),
            ids: Vec::new(),
        };
        let mut joining = Vec::new();
        for number in 0..options.ring.viewers() {
            let place = Place {
                ring: options.ring,
                number,
                overlap,
                decodes: options.decodes,
            };
            let camera = options.ring.camera(number, overlap, 0.0);
            let hello = Hello {
                quality: options.quality.map(QualityChoice::Preset),
                stereo: options.stereo,
                ..Hello::new(options.size, options.fps, camera)
            };
            let (joined, has_joined) = oneshot::channel();
            joining.push(has_joined);
            crowd.tasks.push(tokio::spawn(run_viewer(
                address.clone(),
                hello,
                place,
                crowd.phase.subscribe(),
                joined,
            )));
        }
        for (number, has_joined) in joining.into_iter().enumerate() {
            match has_joined.await {
                Ok(id) => crowd.ids.push(id),
                // Its task has ended before the welcome.
                Err(_) => return Err(crowd.why_lost(number).await),
            }
        }
        Ok(crowd)
    }

    /// The viewers' numbers at the server.
    pub(super) fn ids(&self) -> &[ViewerId] {
        &self.ids
    }

    /// An error, if a viewer has lost its connection.
    pub(super) async fn check(&mut self) -> Result<(), LoadError> {
        match self.tasks.iter().position(ViewerTask::is_finished) {
            Some(number) => Err(self.why_lost(number).await),
            None => Ok(()),
        }
    }

    /// Lets everybody turn for a while.
    pub(super) async fn turn(
        &mut self,
        speed_deg_per_s: f64,
        duration: Duration,
    ) -> Result<(), LoadError> {
        self.phase.send_replace(Phase::Turn {
            begun: Instant::now(),
            speed_deg_per_s,
        });
        sleep(duration).await;
        self.phase.send_replace(Phase::Hold);
        self.check().await
    }

    /// Lets everybody leave and tell what they saw, in the order of the ring.
    pub(super) async fn leave(mut self) -> Result<Vec<ViewerFigures>, LoadError> {
        self.phase.send_replace(Phase::Leave);
        let mut figures = Vec::new();
        for (number, task) in std::mem::take(&mut self.tasks).into_iter().enumerate() {
            figures.push(viewer_result(number, task).await?);
        }
        Ok(figures)
    }

    /// The error of a viewer whose task ends or has ended.
    async fn why_lost(&mut self, number: usize) -> LoadError {
        let left = LoadError::ViewerLost {
            number,
            reason: "it left by itself".to_owned(),
        };
        if number >= self.tasks.len() {
            return left;
        }
        let task = self.tasks.swap_remove(number);
        viewer_result(number, task).await.err().unwrap_or(left)
    }
}

impl Drop for Crowd {
    fn drop(&mut self) {
        for task in &self.tasks {
            task.abort();
        }
    }
}

async fn viewer_result(number: usize, task: ViewerTask) -> Result<ViewerFigures, LoadError> {
    let lost = |reason: String| LoadError::ViewerLost { number, reason };
    task.await
        .map_err(|error| lost(error.to_string()))?
        .map_err(|error| lost(error.to_string()))
}
