//! Schemathesis, which makes requests out of the OpenAPI document, against a real server: no server error, and no answer
//! that the document does not have.
//!
//! `deploy/test` installs it into `target/schemathesis`; `SCHEMATHESIS` names another one. Operations whose answers have no end (events)
//! or that render pictures for seconds (snapshots) are left to the server's own tests.

use std::path::PathBuf;
use std::process::Command;

use skycell_tests::Server;
use skycell_tests::server::target_dir;

/// Test cases of an operation where nobody says: `SKYCELL_SCHEMATHESIS_EXAMPLES`.
const EXAMPLES: &str = "25";

fn schemathesis() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("SCHEMATHESIS") {
        return Some(named.into());
    }
    let installed = target_dir().ok()?.join("schemathesis/bin/schemathesis");
    installed.exists().then_some(installed)
}

#[tokio::test(flavor = "multi_thread")]
async fn no_request_that_the_document_makes_is_answered_otherwise_than_it_says()
-> anyhow::Result<()> {
    let Some(program) = schemathesis() else {
        eprintln!(
            "SKIPPED: schemathesis is not installed. To run it: python3 -m venv target/schemathesis && \
             target/schemathesis/bin/pip install -r tests/schemathesis.txt"
        );
        return Ok(());
    };
    let server = Server::start().await?;
    let scratch = tempfile::tempdir()?;
    let examples =
        std::env::var("SKYCELL_SCHEMATHESIS_EXAMPLES").unwrap_or_else(|_| EXAMPLES.to_owned());
    let output = tokio::task::spawn_blocking({
        let url = format!("http://{}/api/v1/openapi.json", server.address());
        move || {
            Command::new(program)
                .current_dir(scratch.path())
                .args(["--no-color", "run", &url])
                .args(["--phases", "examples,coverage,fuzzing"])
                .args([
                    "--checks",
                    "not_a_server_error,status_code_conformance,content_type_conformance,\
                     response_headers_conformance,response_schema_conformance,unsupported_method,allow_header_conformance",
                ])
                .args(["--exclude-operation-id", "listenToScene"])
                .args(["--exclude-operation-id", "getSnapshot"])
                .args(["--max-examples", &examples])
                .args(["--seed", "1", "--no-shrink", "--continue-on-failure"])
                // A change of the scene may wait for maps.
                .args(["--request-timeout", "70", "--suppress-health-check", "all"])
                .output()
        }
    })
    .await??;
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{said}");
    assert!(
        output.status.success(),
        "schemathesis has found something: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    // The server is still there, and its scene is one.
    server.api().scene().await?;
    Ok(())
}
