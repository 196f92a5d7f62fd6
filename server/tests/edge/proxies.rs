//! Limits per address behind a reverse proxy: a proxy is a connection from its address with the headers that it writes.

use std::net::{IpAddr, Ipv4Addr};

use reqwest::StatusCode;
use serde_json::Value;
use skycell_server::access::{ProxyHeader, ProxyNet};
use skycell_server::config::Config;
use tokio_tungstenite::connect_async;

use crate::client::{Client, handshake, hello_json};
use crate::stand_in::Behaviour;
use crate::world::{World, start_with};

/// Where the proxy of these tests is.
const PROXY: IpAddr = IpAddr::V4(Ipv4Addr::new(127, 0, 0, 2));
/// Somebody who is none.
const OTHER: IpAddr = IpAddr::V4(Ipv4Addr::new(127, 0, 0, 3));

fn net(text: &str) -> ProxyNet {
    ProxyNet::parse(text).expect("a network")
}

fn trusting(config: &mut Config, header: ProxyHeader) {
    config.trusted_proxies = vec![net("127.0.0.2"), net("10.0.0.0/8")];
    config.proxy_header = header;
}

/// Few requests of an address, so that a test sees whose are counted together.
async fn world(header: ProxyHeader) -> World {
    start_with(Behaviour::default(), |config| {
        trusting(config, header);
        config.limits.requests_per_s = Some(1);
        config.limits.requests_burst = Some(3);
    })
    .await
}

/// How many of ten requests pass that come from an address with a header.
async fn passed(world: &World, from: IpAddr, name: &str, value: impl Fn(u32) -> String) -> u32 {
    let http = reqwest::Client::builder()
        .local_address(from)
        .build()
        .expect("a client");
    let mut passed = 0;
    for number in 0..10 {
        let response = http
            .get(format!("http://{}/livez", world.address()))
            .header(name, value(number))
            .send()
            .await
            .expect("an answer");
        match response.status() {
            StatusCode::OK => passed += 1,
            status => assert_eq!(status, StatusCode::TOO_MANY_REQUESTS),
        }
    }
    passed
}

#[tokio::test(flavor = "multi_thread")]
async fn clients_of_a_trusted_proxy_are_told_apart() {
    let (xff, forwarded) = ("x-forwarded-for", "forwarded");
    for (header, name) in [
        (ProxyHeader::XForwardedFor, xff),
        (ProxyHeader::Forwarded, forwarded),
    ] {
        let world = world(header).await;
        let told = |address: String| match header {
            ProxyHeader::XForwardedFor => address,
            ProxyHeader::Forwarded => format!("for={address};proto=https"),
        };
        let each_another = passed(&world, PROXY, name, |n| told(format!("192.0.2.{n}"))).await;
        assert_eq!(each_another, 10, "ten clients");
        // One of them goes on, by another proxy before the trusted one as well.
        let one = passed(&world, PROXY, name, |n| {
            let by_two = format!("{}, {}", told("192.0.2.99".into()), told("10.1.2.3".into()));
            if n % 2 == 0 {
                told("192.0.2.99".into())
            } else {
                by_two
            }
        })
        .await;
        assert!((3..=6).contains(&one), "{one} of one client");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_client_writes_itself_changes_nothing() {
    let (xff, forwarded) = ("x-forwarded-for", "forwarded");
    // Who is no trusted proxy.
    let own = world(ProxyHeader::XForwardedFor).await;
    let spoofed = passed(&own, OTHER, xff, |n| format!("192.0.2.{n}")).await;
    assert!((3..=6).contains(&spoofed), "{spoofed}");
    // Who stands behind one: what it wrote is left of what the proxy adds.
    let own = world(ProxyHeader::XForwardedFor).await;
    let left = passed(&own, PROXY, xff, |n| format!("192.0.2.{n}, 198.51.100.1")).await;
    assert!((3..=6).contains(&left), "{left}");
    // The other header passes such a proxy as it is.
    let own = world(ProxyHeader::XForwardedFor).await;
    let other = passed(&own, PROXY, forwarded, |n| format!("for=192.0.2.{n}")).await;
    assert!((3..=6).contains(&other), "{other}");
    // Without the setting nobody is believed.
    let plain = start_with(Behaviour::default(), |config| {
        config.limits.requests_per_s = Some(1);
        config.limits.requests_burst = Some(3);
    })
    .await;
    let none = passed(&plain, PROXY, xff, |n| format!("192.0.2.{n}")).await;
    assert!((3..=6).contains(&none), "{none}");
}

/// A viewer behind the proxy; how its session begins.
async fn viewer(world: &World, client: &str) -> (Client, Option<u16>) {
    let mut request = handshake(world.address(), Some("skycell.v1"));
    let value = client.parse().expect("a header");
    request.headers_mut().insert("x-forwarded-for", value);
    // Its connection comes from the loopback address that is trusted in that test.
    let (socket, _) = connect_async(request).await.expect("connects");
    let mut client = Client { socket };
    client.say(&hello_json()).await;
    match client.hear().await {
        crate::client::Heard::Message(skycell_protocol::message::ServerMessage::Welcome(_)) => {
            (client, None)
        }
        _ => {
            let (code, error) = client.end().await;
            assert_eq!(error, None, "told before");
            (client, Some(code))
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn viewers_are_counted_by_client_and_connections_of_the_proxy_are_not() {
    let world = start_with(Behaviour::default(), |config| {
        config.trusted_proxies = vec![net("127.0.0.1")];
        config.limits.viewers_per_peer_max = Some(2);
        config.limits.connections_per_peer_max = Some(1);
    })
    .await;
    let mut here = Vec::new();
    for client in ["192.0.2.1", "192.0.2.1", "192.0.2.2", "2001:db8::1"] {
        let (viewer, refused) = viewer(&world, client).await;
        assert_eq!(refused, None, "{client}");
        here.push(viewer);
    }
    let (_, refused) = viewer(&world, "192.0.2.1").await;
    assert_eq!(refused, Some(1013));
    // As many connections as viewers, and a request beside them.
    let viewers: Value = world.get_json("/api/v1/viewers").await;
    assert_eq!(viewers.as_array().map(Vec::len), Some(here.len()));
}
