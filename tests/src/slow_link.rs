//! A link that carries so many bytes a second, in front of a server: a relay that anybody may run.

use std::net::SocketAddr;
use std::time::Duration;

use anyhow::Context;
use skycell_client::ServerAddress;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpSocket};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};

use crate::Server;

/// What the relay holds of a connection, and what it asks the system to hold before it: little, so that what does not fit
/// waits where it comes from, as it does in front of a modem that holds little.
const CHUNK_BYTES: usize = 1024;
const SYSTEM_BUFFER_BYTES: u32 = 4096;

/// A relay to a server; ends when dropped.
pub struct SlowLink {
    address: SocketAddr,
    tasks: JoinSet<()>,
}

impl SlowLink {
    /// A link to the server that carries `bytes_per_s` towards the viewer, and all towards the server.
    ///
    /// # Errors
    /// When there is no port.
    pub async fn to(server: &Server, bytes_per_s: f64) -> anyhow::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0").await?;
        let address = listener.local_addr()?;
        let server: SocketAddr = server.address().parse()?;
        let mut tasks = JoinSet::new();
        tasks.spawn(async move {
            // Ends with the relay.
            let mut connections = JoinSet::new();
            while let Ok((viewer, _)) = listener.accept().await {
                connections.spawn(async move {
                    let _ = carry(viewer.into_split(), server, bytes_per_s).await;
                });
            }
        });
        Ok(Self { address, tasks })
    }

    /// Where viewers connect.
    ///
    /// # Errors
    /// Never for a link that was made.
    pub fn client_address(&self) -> anyhow::Result<ServerAddress> {
        Ok(format!("http://{}", self.address).parse()?)
    }

    /// Ends it, and with it all connections.
    pub fn cut(mut self) {
        self.tasks.abort_all();
    }
}

async fn carry(
    (mut from_viewer, mut to_viewer): (OwnedReadHalf, OwnedWriteHalf),
    server: SocketAddr,
    bytes_per_s: f64,
) -> anyhow::Result<()> {
    let socket = TcpSocket::new_v4()?;
    socket.set_recv_buffer_size(SYSTEM_BUFFER_BYTES)?;
    let stream = socket.connect(server).await?;
    stream.set_nodelay(true)?;
    to_viewer.as_ref().set_nodelay(true)?;
    let (mut from_server, mut to_server) = stream.into_split();
    let up = async {
        tokio::io::copy(&mut from_viewer, &mut to_server).await?;
        anyhow::Ok(())
    };
    let down = async {
        let mut chunk = [0; CHUNK_BYTES];
        let mut free_at = Instant::now();
        loop {
            let bytes = from_server.read(&mut chunk).await?;
            anyhow::ensure!(bytes > 0, "the server has closed");
            // What has come takes the link after what came before.
            free_at =
                free_at.max(Instant::now()) + Duration::from_secs_f64(bytes as f64 / bytes_per_s);
            sleep_until(free_at).await;
            let written = to_viewer.write_all(&chunk[..bytes]).await;
            written.context("the viewer is gone")?;
        }
    };
    tokio::select! {
        result = up => result,
        result = down => result,
    }
}
