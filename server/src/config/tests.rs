use std::io::Write;

use skycell_protocol::QualityPreset;

use super::*;

fn file(text: &str) -> tempfile::NamedTempFile {
    let mut file = tempfile::NamedTempFile::new().expect("a temporary file");
    file.write_all(text.as_bytes()).expect("written");
    file
}

fn variables(list: &[(&str, &str)]) -> Vec<(String, String)> {
    list.iter()
        .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
        .collect()
}

fn resolve(text: &str, environment: &[(&str, &str)]) -> Result<Config, ConfigError> {
    let file = file(text);
    let flags = Flags {
        file: Some(file.path().to_owned()),
        ..Flags::default()
    };
    Config::resolve(&flags, &variables(environment))
}

#[test]
fn flags_beat_the_environment_and_the_environment_beats_the_file() {
    let file =
        file("listen = '127.0.0.1:1'\nviewers_max = 2\n[render]\nsamples = 4\nmip_bias = 1\n");
    let environment = variables(&[
        ("SKYCELL_LISTEN", "127.0.0.1:2"),
        ("SKYCELL_RENDER_SAMPLES", "5"),
        (
            "SKYCELL_ALLOWED_ORIGINS",
            "https://a.example, https://b.example",
        ),
        ("SKYCELL_CONFIG", file.path().to_str().expect("UTF-8")),
    ]);
    let flags = Flags {
        listen: Some(SocketAddr::from(([127, 0, 0, 1], 3))),
        state_dir: Some(PathBuf::from("state")),
        ..Flags::default()
    };
    let config = Config::resolve(&flags, &environment).expect("resolves");
    assert_eq!(config.listen.port(), 3);
    assert_eq!(config.viewers_max, 2);
    assert_eq!(
        (config.render.samples, config.render.mip_bias),
        (Some(5), Some(1.0))
    );
    assert_eq!(config.state_dir, PathBuf::from("state"));
    assert_eq!(config.render.noise_cache_dir, PathBuf::from("state/cache"));
    assert_eq!(
        config.allowed_origins,
        ["https://a.example", "https://b.example"]
    );
}

#[test]
fn nothing_configured_is_the_default_on_the_loopback_interface() {
    let config = Config::resolve(&Flags::default(), &[]).expect("resolves");
    assert_eq!(config.listen.to_string(), "127.0.0.1:8080");
    assert_eq!(config, Config::new(config.state_dir.clone()));
}

#[test]
fn unknown_keys_are_refused_with_the_nearest_known_one() {
    for (text, pointer, nearest) in [
        ("lisen = 'x'", "/lisen", "listen"),
        ("[render]\nmipbias = 1", "/render/mipbias", "mip_bias"),
        (
            "[[cells]]\nname='a'\ncentre_m=[0,0,0]\nradius_m=5",
            "/cells/0/centre_m",
            "center_m",
        ),
    ] {
        let message = resolve(text, &[]).expect_err("unknown").to_string();
        assert!(message.contains(pointer), "{message}");
        assert!(
            message.contains(&format!("did you mean \"{nearest}\"")),
            "{message}"
        );
    }
}

#[test]
fn a_bad_value_is_told_with_its_source_and_what_is_allowed() {
    for (text, environment, parts) in [
        (
            "viewers_max = 0",
            vec![],
            ["file ", "/viewers_max is 0; allowed: 1 to 1024"],
        ),
        (
            "video_kbit_per_s = 99",
            vec![],
            ["file ", "/video_kbit_per_s is 99; allowed: 100 to 50000"],
        ),
        (
            "[render]\nsamples = 17",
            vec![],
            ["file ", "/render/samples is 17; allowed: 1 to 16"],
        ),
        (
            "[render]\nproxies = 'static-dome'\nslabs = 2",
            vec![],
            ["file ", "/render/slabs is 2; allowed: 1 with static-dome"],
        ),
        (
            "[render]\ntransitions = 'own-rays'",
            vec![],
            [
                "file ",
                "/render/transitions is \"own-rays\"; allowed: \"fade\"; \"own-rays\" with parallax_steps = 0",
            ],
        ),
        (
            "[render]\ntransitions = 'own-rays'\nparallax_steps = 0\nslabs = 2",
            vec![],
            ["file ", "slabs = 1 and proxies = \"in-layer\" alone"],
        ),
        (
            "[render]\ntransitions = 'jump'",
            vec![],
            [
                "file ",
                "/render/transitions is \"jump\"; allowed: \"fade\"",
            ],
        ),
        (
            "[render]\nbands = 5",
            vec![],
            ["file ", "/render/bands is 5; allowed: 2 to 4"],
        ),
        (
            "",
            vec![("SKYCELL_RENDER_PROXIES", "dome")],
            [
                "environment",
                "/render/proxies is \"dome\"; allowed: \"in-layer\"",
            ],
        ),
        (
            "[render]\nquality = {max_error = 2}",
            vec![],
            [
                "file ",
                "/render/quality/max_error is 2; allowed: 0.001 to 1",
            ],
        ),
        (
            "",
            vec![("SKYCELL_RENDER_QUALITY", "best")],
            [
                "environment",
                "/render/quality is \"best\"; allowed: \"draft\"",
            ],
        ),
        (
            "render = 3",
            vec![],
            ["file ", "/render is 3; allowed: an object"],
        ),
        (
            "",
            vec![("SKYCELL_RENDER_MIP_BIAS", "much")],
            ["environment", "/render/mip_bias is \"much\""],
        ),
        (
            "",
            vec![("SKYCELL_LISTEN", "8080")],
            ["environment", "/listen is \"8080\"; allowed: ADDRESS:PORT"],
        ),
        (
            "[[cells]]\nname='a'\ncenter_m=[0,-101,0]\nradius_m=5",
            vec![],
            ["file ", "/cells/0/center_m/1 is -101"],
        ),
        (
            "[[cells]]\nname='a'\ncenter_m=[0,0,0]\nradius_m=5\n[[cells]]\nname='a'\ncenter_m=[0,0,0]\nradius_m=5",
            vec![],
            ["file ", "/cells/1/name"],
        ),
        (
            "trusted_proxies = ['10.0.0.1', '0.0.0.0/0']",
            vec![],
            [
                "file ",
                "/trusted_proxies/1 is \"0.0.0.0/0\"; allowed: an address or a network",
            ],
        ),
        (
            "",
            vec![("SKYCELL_PROXY_HEADER", "via")],
            [
                "environment",
                "/proxy_header is \"via\"; allowed: \"x-forwarded-for\"",
            ],
        ),
        (
            "[limits]\nmegapixels_max = 0",
            vec![],
            ["file ", "/limits/megapixels_max is 0; allowed: 1 to 16384"],
        ),
        (
            "",
            vec![("SKYCELL_LIMITS_FAILED_TOKENS_PER_MIN", "1001")],
            [
                "environment",
                "/limits/failed_tokens_per_min is 1001; allowed: 1 to 1000",
            ],
        ),
        (
            "[tls]\ncertificate = 'cert.pem'",
            vec![],
            ["file ", "/tls/key is missing; allowed: a PEM file"],
        ),
        (
            "[limits]\nrequests_per_second = 5",
            vec![],
            [
                "/limits/requests_per_second",
                "did you mean \"requests_per_s\"",
            ],
        ),
        ("a = ", vec![], ["is not TOML", "line 1"]),
    ] {
        let message = resolve(text, &environment).expect_err("bad").to_string();
        for part in parts {
            assert!(message.contains(part), "{message}");
        }
    }
    let missing = Flags {
        file: Some(PathBuf::from("no/such/file.toml")),
        ..Flags::default()
    };
    let message = Config::resolve(&missing, &[])
        .expect_err("missing")
        .to_string();
    assert!(message.contains("no/such/file.toml"), "{message}");
}

#[test]
fn a_quality_is_a_name_or_an_object_in_the_file_and_in_the_environment() {
    for (text, environment, choice) in [
        (
            "[render]\nquality = 'draft'",
            vec![],
            QualityChoice::Preset(QualityPreset::Draft),
        ),
        (
            "[render]\nquality = {budget_ms = 5}",
            vec![],
            QualityChoice::BudgetMs(5.0),
        ),
        (
            "",
            vec![("SKYCELL_RENDER_QUALITY", "reference")],
            QualityChoice::Preset(QualityPreset::Reference),
        ),
        (
            "",
            vec![("SKYCELL_RENDER_QUALITY", "{\"max_error\": 0.01}")],
            QualityChoice::MaxError(0.01),
        ),
    ] {
        let config = resolve(text, &environment).expect("resolves");
        assert_eq!(
            config.render.quality,
            Some(choice),
            "{text} {environment:?}"
        );
    }
}

#[test]
fn a_variable_of_somebody_else_does_no_harm() {
    assert!(resolve("", &[("SKYCELL_SERVICE_HOST", "10.0.0.1")]).is_ok());
}

#[test]
fn budgets_come_from_both_sources_and_are_refused_out_of_range() {
    let environment = [
        ("SKYCELL_RENDER_MARCH_SHARE", "0.5"),
        ("SKYCELL_RENDER_AGE_FACTOR", "0.25"),
    ];
    let config = resolve("[render]\ncell_memory_mib = 32\n", &environment).expect("resolves");
    assert_eq!(config.render.age_factor, 0.25);
    assert_eq!(config.render.cell_memory_mib, Some(32));
    assert_eq!(config.render.march_share, 0.5);
    let config = resolve("", &[]).expect("resolves");
    assert_eq!(config.render.cell_memory_mib, None);
    assert_eq!(config.render.age_factor, 1.0);
    for (text, named) in [
        ("[render]\ncell_memory_mib = 3\n", "cell_memory_mib is 3"),
        ("[render]\nmarch_share = 0\n", "march_share is 0"),
        ("[render]\nmarch_share = 1.5\n", "march_share is 1.5"),
        ("[render]\nage_factor = 0.05\n", "age_factor is 0.05"),
        ("[render]\nage_factor = 5\n", "age_factor is 5"),
    ] {
        let error = resolve(text, &[]).expect_err(text).to_string();
        assert!(error.contains(named), "{error}");
    }
}

#[test]
fn each_value_is_told_with_where_it_comes_from() {
    let file = file("viewers_max = 2\nlog = 'debug'\n[render]\nsamples = 4\nslabs = 2\n");
    let flags = Flags {
        listen: Some(SocketAddr::from(([127, 0, 0, 1], 3))),
        file: Some(file.path().to_owned()),
        ..Flags::default()
    };
    let environment = variables(&[("SKYCELL_LOG", "warn"), ("SKYCELL_DRAIN_S", "7")]);
    let told = Config::explain_with(&flags, &environment).expect("resolves");
    let path = file.path().display().to_string();
    for (key, value, from) in [
        (
            "listen",
            serde_json::json!("127.0.0.1:3"),
            "the command line",
        ),
        ("log", serde_json::json!("warn"), "SKYCELL_LOG"),
        ("drain_s", serde_json::json!(7.0), "SKYCELL_DRAIN_S"),
        ("viewers_max", serde_json::json!(2), &path),
        ("render.samples", serde_json::json!(4), &path),
        ("render.slabs", serde_json::json!(2), &path),
        ("render.bands", serde_json::json!(3), "default"),
        ("cells", serde_json::json!([]), "default"),
        ("viewer_stall_s", serde_json::json!(30.0), "default"),
        ("render.march_steps", Value::Null, "default"),
    ] {
        let found = told.iter().find(|origin| origin.key == key).expect(key);
        assert_eq!((&found.value, found.from.as_str()), (&value, from), "{key}");
    }
}

#[test]
fn a_collectors_address_has_no_secrets() {
    let good = resolve("otlp_endpoint = 'http://127.0.0.1:4318'", &[]).expect("resolves");
    assert_eq!(good.otlp_endpoint.as_deref(), Some("http://127.0.0.1:4318"));
    for bad in [
        "http://",
        "localhost:4318",
        "http://me:secret@host:4318",
        "http://host/?key=secret",
    ] {
        let message = resolve(&format!("otlp_endpoint = '{bad}'"), &[])
            .expect_err("refused")
            .to_string();
        assert!(message.contains("http://HOST:PORT"), "{message}");
        assert!(!message.contains("secret"), "{message}");
    }
}

#[test]
fn tokens_come_from_the_file_and_the_environment_and_are_never_repeated() {
    let line = |role: &str, name: &str| format!("{role} {name} sha256:{}", "ab".repeat(32));
    let text = format!("tokens = ['{}']", line("view", "guests"));
    let config = resolve(&text, &[]).expect("a token");
    assert_eq!(config.tokens.0.len(), 1);
    let both = format!("{},{}", line("view", "a"), line("admin", "b"));
    let config = resolve("", &[("SKYCELL_TOKENS", &both)]).expect("tokens");
    assert_eq!(config.tokens.0[1].role, crate::access::Role::Admin);
    let written = serde_json::to_string(&config).expect("JSON");
    assert!(
        written.contains("admin b") && !written.contains("abab"),
        "{written}"
    );
    for (text, environment) in [
        ("tokens = ['sky_secret']", vec![]),
        ("tokens = [['sky_secret']]", vec![]),
        ("", vec![("SKYCELL_TOKENS", "view a sky_secret")]),
    ] {
        let message = resolve(text, &environment).expect_err("none").to_string();
        assert!(message.contains("/tokens/0"), "{message}");
        assert!(!message.contains("sky_secret"), "{message}");
    }
}

#[test]
fn a_server_behind_a_proxy_is_not_for_this_machine_alone() {
    let variables = [("SKYCELL_TRUSTED_PROXIES", "127.0.0.1, fd00::/8")];
    let config = resolve("proxy_header = 'forwarded'", &variables).expect("resolves");
    assert_eq!(config.trusted_proxies.len(), 2);
    assert!(!config.serves_this_machine_alone());
    let text = serde_json::to_value(&config).expect("JSON");
    assert_eq!(
        text["trusted_proxies"],
        serde_json::json!(["127.0.0.1/32", "fd00::/8"])
    );
    assert_eq!(text["proxy_header"], "forwarded");
    assert!(
        resolve("", &[])
            .expect("resolves")
            .serves_this_machine_alone()
    );
}
