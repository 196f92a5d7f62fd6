//! A viewer that reads and acknowledges in the background, as a client should.

use anyhow::{Context, bail};
use skycell_client::{Connection, ConnectionLimits, Event, Frame};
use skycell_protocol::message::{Acknowledgement, ErrorMessage, Hello, Status, ViewChange};
use skycell_protocol::{Camera, FrameHeader, FrameSize, InputSequence, ViewerId};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;

use crate::{PATIENCE, Server};

/// What a viewer has seen so far.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// The newest picture.
    pub frame: Option<Frame>,
    /// How many pictures came.
    pub frames: u64,
    /// The newest status.
    pub status: Option<Status>,
    /// The newest heartbeat.
    pub heartbeat: Option<FrameHeader>,
    /// The newest complaint.
    pub complaint: Option<ErrorMessage>,
    /// Why the session ended, when it has.
    pub ended: Option<String>,
}

impl Seen {
    /// The newest picture.
    ///
    /// # Errors
    /// When none has come.
    pub fn frame(&self) -> anyhow::Result<&Frame> {
        self.frame.as_ref().context("no frame has come")
    }
}

enum Order {
    Look(Camera, oneshot::Sender<InputSequence>),
    Wish(ViewChange),
    Close,
}

/// A viewer in the background.
pub struct Viewer {
    id: ViewerId,
    seen: watch::Receiver<Seen>,
    orders: mpsc::Sender<Order>,
    task: JoinHandle<()>,
}

/// Looks from the ground at a place. Angles in degrees as `skycell_protocol` has them.
///
/// # Errors
/// When a number is out of range.
pub fn camera(position_m: [f64; 3], yaw_deg: f64, pitch_deg: f64) -> anyhow::Result<Camera> {
    Ok(Camera::new(position_m, yaw_deg, pitch_deg, 60.0)?)
}

impl Viewer {
    /// A viewer of 320x180 pixels at the origin.
    ///
    /// # Errors
    /// When the server does not welcome it.
    pub async fn join(server: &Server, yaw_deg: f64) -> anyhow::Result<Self> {
        let camera = camera([0.0, 2.0, 0.0], yaw_deg, 20.0)?;
        Self::join_as(server, Hello::new(FrameSize::new(320, 180)?, 30.0, camera)).await
    }

    /// A viewer with its own wishes.
    ///
    /// # Errors
    /// When the server does not welcome it.
    pub async fn join_as(server: &Server, hello: Hello) -> anyhow::Result<Self> {
        let address = server.client_address()?;
        let connection = Connection::open(&address, hello, ConnectionLimits::default()).await?;
        let id = connection.welcome().viewer;
        let (seen_sender, seen) = watch::channel(Seen::default());
        let (orders, order_receiver) = mpsc::channel(16);
        let task = tokio::spawn(run(connection, seen_sender, order_receiver));
        Ok(Self {
            id,
            seen,
            orders,
            task,
        })
    }

    /// Its number.
    pub fn id(&self) -> ViewerId {
        self.id
    }

    /// Looks somewhere else; frames tell the number that this returns.
    ///
    /// # Errors
    /// When the session has ended.
    pub async fn look(&self, camera: Camera) -> anyhow::Result<InputSequence> {
        let (answer, sent) = oneshot::channel();
        self.orders
            .send(Order::Look(camera, answer))
            .await
            .context("the session has ended")?;
        sent.await.context("the session has ended")
    }

    /// Wishes other frames. What the server thinks of it comes as a complaint, if anything.
    ///
    /// # Errors
    /// When the session has ended.
    pub async fn wish(&self, change: ViewChange) -> anyhow::Result<()> {
        let wish = self.orders.send(Order::Wish(change));
        wish.await.context("the session has ended")
    }

    /// What has been seen so far.
    pub fn seen(&self) -> Seen {
        self.seen.borrow().clone()
    }

    /// Waits until what was seen is as wanted.
    ///
    /// # Errors
    /// When the session ends or it takes too long; `what` was wanted.
    pub async fn wait_for(
        &self,
        what: &str,
        mut wanted: impl FnMut(&Seen) -> bool,
    ) -> anyhow::Result<Seen> {
        let mut receiver = self.seen.clone();
        let waiting = receiver.wait_for(|seen| seen.ended.is_some() || wanted(seen));
        let seen = tokio::time::timeout(PATIENCE, waiting)
            .await
            .with_context(|| format!("viewer {} waits in vain for {what}", self.id))?
            .context("the viewer is gone")?
            .clone();
        if let Some(reason) = &seen.ended {
            bail!("waiting for {what}, the session ended: {reason}");
        }
        Ok(seen)
    }

    /// Waits for a picture.
    ///
    /// # Errors
    /// As [`Self::wait_for`].
    pub async fn picture(&self) -> anyhow::Result<Seen> {
        self.wait_for("a picture", |seen| seen.frame.is_some())
            .await
    }

    /// Says goodbye.
    pub async fn close(self) {
        let _ = self.orders.send(Order::Close).await;
        let _ = self.task.await;
    }
}

async fn run(
    mut connection: Connection,
    seen: watch::Sender<Seen>,
    mut orders: mpsc::Receiver<Order>,
) {
    let failed = loop {
        let done = tokio::select! {
            event = connection.next_event() => match event {
                Ok(event) => note(event, &mut connection, &seen).await,
                Err(error) => Err(error),
            },
            order = orders.recv() => match order {
                Some(Order::Look(camera, answer)) => connection.send_camera(camera).await.map(|input| {
                    let _ = answer.send(input);
                }),
                Some(Order::Wish(change)) => connection.change_view(change).await,
                Some(Order::Close) | None => return connection.close().await,
            },
        };
        if let Err(error) = done {
            break error;
        }
    };
    seen.send_modify(|seen| seen.ended = Some(failed.to_string()));
}

async fn note(
    event: Event,
    connection: &mut Connection,
    seen: &watch::Sender<Seen>,
) -> Result<(), skycell_client::ConnectionError> {
    match event {
        Event::Frame(frame) => {
            let sequence = frame.header.sequence;
            seen.send_modify(|seen| {
                seen.frames += 1;
                seen.frame = Some(frame);
            });
            connection
                .acknowledge(Acknowledgement::of(sequence))
                .await?;
        }
        Event::Heartbeat(header) => seen.send_modify(|seen| seen.heartbeat = Some(header)),
        Event::Status(status) => seen.send_modify(|seen| seen.status = Some(status)),
        Event::Complaint(complaint) => {
            seen.send_modify(|seen| seen.complaint = Some(complaint));
        }
        _ => {}
    }
    Ok(())
}
