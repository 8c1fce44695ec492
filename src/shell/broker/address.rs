//! Where a broker is, and what it takes to be let in: `mqtts://host:8883`, certificates, credentials.

use super::failure::{VERSION_1, is_of_version_1};
use super::{KEEP_ALIVE, MAX_PACKET_BYTES, SESSION_EXPIRY_SECONDS};
use crate::diagnostic::Diagnostic;
use crate::regular_file::{read, required_text};
use crate::text::printable_path;
use rumqttc::tokio_rustls::rustls::crypto::ring;
use rumqttc::tokio_rustls::rustls::pki_types::pem::PemObject;
use rumqttc::tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rumqttc::tokio_rustls::rustls::{self, ClientConfig, RootCertStore};
use rumqttc::{MqttOptions, TlsConfiguration, Transport};
use serde::Deserialize;
use std::env;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

/// Largest file of certificates or a key, in bytes.
const MAX_PEM_BYTES: u64 = 1 << 20;

/// Environment variables with user and password.
const USER: &str = "DESCAN_MQTT_USER";
const PASSWORD: &str = "DESCAN_MQTT_PASSWORD";

/// Where a broker is: `mqtt://HOST[:PORT]` or, with TLS, `mqtts://HOST[:PORT]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BrokerAddress {
    host: String,
    port: u16,
    has_tls: bool,
}

impl FromStr for BrokerAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (scheme, rest) = text.split_once("://").unwrap_or(("", text));
        let (has_tls, usual_port) = match scheme.to_ascii_lowercase().as_str() {
            "mqtts" => (true, 8883),
            "mqtt" => (false, 1883),
            _ => return Err("write mqtts://HOST[:PORT], or mqtt:// without TLS".to_owned()),
        };
        let rest = rest.strip_suffix('/').unwrap_or(rest);
        if rest.contains('/') {
            return Err("an address has no path; write mqtts://HOST[:PORT]".to_owned());
        }
        if rest.contains('@') {
            return Err(format!(
                "user and password are not part of the address, which others can see; put them in \
                 a file (--credentials), or in {USER} and {PASSWORD}"
            ));
        }
        // An IPv6 address is in brackets.
        let (host, port) = match rest.strip_prefix('[').and_then(|it| it.split_once(']')) {
            Some((host, "")) => (host, None),
            Some((host, port)) => (host, Some(port.strip_prefix(':').unwrap_or("?"))),
            None => rest.rsplit_once(':').map_or((rest, None), |(host, port)| (host, Some(port))),
        };
        let is_host = |byte: u8| byte.is_ascii_graphic() && !b"/?#[]".contains(&byte);
        if host.is_empty() || !host.bytes().all(is_host) {
            return Err("no host; write mqtts://HOST[:PORT]".to_owned());
        }
        let port = match port {
            None => usual_port,
            Some(port) => match port.parse() {
                Ok(port) if port > 0 => port,
                _ => return Err("the port is a number from 1 to 65535".to_owned()),
            },
        };
        Ok(Self { host: host.to_owned(), port, has_tls })
    }
}

impl BrokerAddress {
    /// Returns true for `mqtts://`.
    pub const fn has_tls(&self) -> bool {
        self.has_tls
    }

    /// Returns true if the connection does not leave this machine.
    fn is_local(&self) -> bool {
        let of_loopback = |it: std::net::IpAddr| it.is_loopback();
        self.host == "localhost" || self.host.parse().is_ok_and(of_loopback)
    }
}

impl fmt::Display for BrokerAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.has_tls { "mqtts" } else { "mqtt" };
        let Self { host, port, .. } = self;
        if host.contains(':') {
            write!(f, "{scheme}://[{host}]:{port}")
        } else {
            write!(f, "{scheme}://{host}:{port}")
        }
    }
}

/// What the user says about a broker.
#[derive(Clone, Debug)]
pub struct BrokerAccess {
    /// Where it is.
    pub address: BrokerAddress,
    /// Certificates that are trusted in place of those of the system (PEM).
    pub ca: Option<PathBuf>,
    /// Certificate of this client, and its key (PEM).
    pub identity: Option<(PathBuf, PathBuf)>,
    /// File with `user` and `password` (TOML).
    pub credentials: Option<PathBuf>,
}

/// What a connection begins with: files and environment are read.
#[derive(Clone)]
pub struct BrokerSettings {
    /// Where it is.
    pub address: BrokerAddress,
    transport: Transport,
    login: Option<(String, String)>,
    /// What the user should know, though it works.
    pub warnings: Vec<String>,
}

/// A file of credentials.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CredentialsFile {
    user: String,
    #[serde(default)]
    password: String,
}

impl BrokerSettings {
    /// Reads the files that are named, and the environment. Without TLS certificates are of no use
    /// and are not read.
    ///
    /// # Errors
    /// A file cannot be used.
    pub fn read(access: &BrokerAccess) -> Result<Self, Diagnostic> {
        let address = access.address.clone();
        let mut warnings = Vec::new();
        let login = login(access.credentials.as_deref(), &mut warnings)?;
        if login.is_some() && !address.has_tls && !address.is_local() {
            warnings.push(format!("{address}: the password is not encrypted; use mqtts://"));
        }
        let transport = if address.has_tls {
            Transport::Tls(TlsConfiguration::Rustls(Arc::new(tls(access)?)))
        } else {
            Transport::Tcp
        };
        Ok(Self { address, transport, login, warnings })
    }

    /// The options of a client that has this name at the broker.
    pub(super) fn options(&self, client: &str) -> MqttOptions {
        let broker = (self.address.host.clone(), self.address.port);
        let mut options = MqttOptions::new(client, broker);
        options.set_transport(self.transport.clone());
        options.set_keep_alive(u16::try_from(KEEP_ALIVE.as_secs()).unwrap_or(u16::MAX));
        options.set_max_packet_size(Some(MAX_PACKET_BYTES));
        options.set_session_expiry_interval(Some(SESSION_EXPIRY_SECONDS));
        if let Some((user, password)) = &self.login {
            options.set_credentials(user.clone(), password.clone());
        }
        options
    }
}

/// User and password, of the file or of the environment.
fn login(
    file: Option<&Path>,
    warnings: &mut Vec<String>,
) -> Result<Option<(String, String)>, Diagnostic> {
    let Some(path) = file else {
        let user = env::var(USER).ok().filter(|user| !user.is_empty());
        let password = env::var(PASSWORD).unwrap_or_default();
        if user.is_none() && !password.is_empty() {
            return Err(Diagnostic::new(format!("{PASSWORD} is set, and {USER} is not")));
        }
        return Ok(user.map(|user| (user, password)));
    };
    let text = required_text(path)?;
    // The text of an error would show the line with the password.
    let file: CredentialsFile = toml::from_str(&text).map_err(|_| {
        let remedy = "write user = \"NAME\" and password = \"PASSWORD\" (TOML)";
        Diagnostic::new(format!("{}: not a file of credentials", printable_path(path)))
            .with_remedy(remedy)
    })?;
    if is_readable_by_others(path) {
        let path = printable_path(path);
        warnings.push(format!("{path}: others can read the password; chmod 600 {path}"));
    }
    Ok(Some((file.user, file.password)))
}

/// Returns true if the file mode lets everyone read.
#[cfg(unix)]
fn is_readable_by_others(path: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    std::fs::metadata(path).is_ok_and(|it| it.permissions().mode() & 0o004 != 0)
}

/// Windows has no file modes; a file there has the access of its folder.
#[cfg(windows)]
fn is_readable_by_others(_: &Path) -> bool {
    false
}

/// The TLS settings: who is trusted, and who this client is.
fn tls(access: &BrokerAccess) -> Result<ClientConfig, Diagnostic> {
    let mut roots = RootCertStore::empty();
    let certificates = match &access.ca {
        Some(path) => certificates(path)?,
        None => rustls_native_certs::load_native_certs().certs,
    };
    // The system may have some that are not understood.
    roots.add_parsable_certificates(certificates);
    if roots.is_empty() {
        return Err(match &access.ca {
            Some(path) => no_pem(path, "certificate"),
            None => Diagnostic::new("the system has no certificates to trust")
                .with_remedy("install ca-certificates, or name a file: --ca FILE"),
        });
    }
    let provider = Arc::new(ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| Diagnostic::new(format!("TLS: {error}")))?
        .with_root_certificates(roots);
    let Some((certificate, key)) = &access.identity else {
        return Ok(builder.with_no_client_auth());
    };
    let chain = certificates_of(certificate)?;
    let pem = read_pem(key)?;
    let private = PrivateKeyDer::from_pem_slice(&pem).map_err(|_| no_pem(key, "private key"))?;
    builder.with_client_auth_cert(chain, private).map_err(|error| {
        if let rustls::Error::InvalidCertificate(why) = &error
            && is_of_version_1(why)
        {
            let cause = format!("{}: a certificate {VERSION_1}", printable_path(certificate));
            return Diagnostic::new(cause)
                .with_remedy("have it signed as one of version 3, as descan help gateways shows");
        }
        let files = format!("{}, {}", printable_path(certificate), printable_path(key));
        Diagnostic::new(format!("{files}: {error}"))
            .with_remedy("name a certificate (--cert) and its own key (--key)")
    })
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, Diagnostic> {
    let pem = read_pem(path)?;
    CertificateDer::pem_slice_iter(&pem)
        .collect::<Result<_, _>>()
        .map_err(|_| no_pem(path, "certificate"))
}

/// The certificates of a file, one at least.
fn certificates_of(path: &Path) -> Result<Vec<CertificateDer<'static>>, Diagnostic> {
    let found = certificates(path)?;
    if found.is_empty() { Err(no_pem(path, "certificate")) } else { Ok(found) }
}

fn read_pem(path: &Path) -> Result<Vec<u8>, Diagnostic> {
    let content = read(path, MAX_PEM_BYTES).map_err(|fault| fault.of(printable_path(path)))?;
    content.ok_or_else(|| Diagnostic::new("file not found").of(printable_path(path)))
}

fn no_pem(path: &Path, what: &str) -> Diagnostic {
    Diagnostic::new(format!("{}: no {what} in it", printable_path(path)))
        .with_remedy("name a file in PEM form (-----BEGIN ...)")
}
