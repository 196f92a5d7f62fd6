//! Start and end.

use std::time::{Duration, Instant};

use serde_json::json;
use skycell_server::config::Config;
use skycell_server::service::{ServiceError, ServiceParts};

use crate::client::{Client, Heard, hello_json};
use crate::stand_in::Behaviour;
use crate::world::{start, start_in, start_with};

#[tokio::test(flavor = "multi_thread")]
async fn a_shutdown_tells_viewers_and_takes_no_more() {
    let world = start().await;
    let address = world.address();
    let mut greeting = Client::connect(address).await;
    let mut client = Client::join(address).await;
    client.frame().await;
    let started = Instant::now();
    let hears = tokio::spawn(async move {
        let greeting_end = greeting.end().await;
        loop {
            if let Heard::Closed { code, reason } = client.hear().await {
                return (greeting_end.0, code, reason);
            }
        }
    });
    world.service.shutdown().await;
    assert!(
        started.elapsed() < Duration::from_secs(3),
        "{:?}",
        started.elapsed()
    );
    let (greeting_code, code, reason) = hears.await.expect("no panic");
    assert_eq!((greeting_code, code), (1012, 1012));
    assert!(reason.contains("shuts down"), "{reason}");
    assert!(tokio::net::TcpStream::connect(address).await.is_err());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shutdown_does_not_wait_for_who_does_not_listen() {
    let behaviour = Behaviour {
        ignores_window: true,
        ..Behaviour::default()
    };
    let world = start_with(behaviour, |_| {}).await;
    let mut hello = hello_json();
    (hello["width"], hello["height"]) = (json!(512), json!(512));
    let (_deaf, _) = Client::join_as(world.address(), hello).await;
    // An HTTP request that never ends.
    let mut slow = tokio::net::TcpStream::connect(world.address())
        .await
        .expect("connects");
    tokio::io::AsyncWriteExt::write_all(&mut slow, b"GET /livez HTTP/1.1\r\nHost: x\r\nX-")
        .await
        .expect("sent");
    tokio::time::sleep(Duration::from_secs(1)).await;
    let started = Instant::now();
    world.service.shutdown().await;
    assert!(
        started.elapsed() < Duration::from_secs(7),
        "{:?}",
        started.elapsed()
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_is_told_when_the_renderer_ends() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    client.frame().await;
    drop(world.renderer);
    let camera = hello_json()["camera"].clone();
    client
        .say(&json!({"type": "camera", "input": 1, "camera": camera}))
        .await;
    assert_eq!(client.end().await, (1011, Some("internal".to_owned())));
    let url = format!("http://{}/readyz", world.service.address());
    assert_eq!(reqwest::get(url).await.expect("an answer").status(), 503);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_in_use_and_a_corrupt_scene_are_told() {
    let world = start().await;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut config = Config::new(folder.path().to_owned());
    config.listen = world.address();
    let parts = ServiceParts::prepare(config).expect("prepares");
    let error = parts
        .start(world.renderer.handle.clone())
        .await
        .err()
        .expect("in use");
    assert!(matches!(error, ServiceError::Listen { .. }));
    assert!(
        error.to_string().contains(&world.address().to_string()),
        "{error}"
    );

    std::fs::write(folder.path().join("scene.json"), "{\"revision\": ").expect("written");
    let error = ServiceParts::prepare(Config::new(folder.path().to_owned()))
        .err()
        .expect("corrupt");
    assert!(
        error.to_string().contains("scene.json holds no scene"),
        "{error}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_starts_again_in_its_folder_and_on_its_address() {
    let world = start().await;
    let address = world.address();
    let mut client = Client::join(address).await;
    client.frame().await;
    let (folder, renderer) = (world.folder, world.renderer);
    tokio::join!(world.service.shutdown(), client.end());
    drop(renderer);
    let (service, _renderer) = start_in(folder.path(), Behaviour::default(), |config| {
        config.listen = address
    })
    .await;
    assert_eq!(service.address(), address);
    Client::join(address).await.frame().await;
}
