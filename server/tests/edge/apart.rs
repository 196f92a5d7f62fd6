//! Each viewer gets its own frames and nobody else's.

use std::collections::BTreeSet;

use serde_json::json;

use crate::client::{Client, hello_json};
use crate::stand_in::viewer_of_picture;
use crate::world::start;

#[tokio::test(flavor = "multi_thread")]
async fn no_viewer_is_sent_anothers_frame_while_others_come_go_and_change() {
    let world = start().await;
    let address = world.address();
    let watches = (0..8_u32).map(|number| {
        tokio::spawn(async move {
            let size = |round: u32| (32 + 4 * number, 16 + 2 * round);
            let mut ids = Vec::new();
            for round in 0..3 {
                let mut hello = hello_json();
                let (width, height) = size(round);
                (hello["width"], hello["height"]) = (json!(width), json!(height));
                hello["camera"]["yaw_deg"] = json!(45 * number);
                let (mut client, welcome) = Client::join_as(address, hello).await;
                for frame in 0..12 {
                    let (header, payload) = client.frame().await;
                    assert_eq!(header.viewer, welcome.viewer);
                    assert_eq!(u32::from(header.width), width, "its own width");
                    let picture = image::load_from_memory(&payload)
                        .expect("a PNG")
                        .into_rgb8();
                    assert_eq!(picture.width(), width);
                    assert_eq!(viewer_of_picture(&picture), welcome.viewer.0);
                    if frame == 6 {
                        // Sizes and cameras change under way.
                        client
                            .say(&json!({"type": "view", "height": height + 1}))
                            .await;
                    }
                }
                ids.push(welcome.viewer);
                drop(client);
            }
            ids
        })
    });
    let mut all = BTreeSet::new();
    for watch in watches.collect::<Vec<_>>() {
        for id in watch.await.expect("its own frames only") {
            assert!(all.insert(id), "viewer {id} was two");
        }
    }
    assert_eq!(all.len(), 24);
}
