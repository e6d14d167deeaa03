//! `quadrille health`: the check that a container runs on itself.

use std::io::{Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpStream};
use std::time::Duration;

use super::Answer;

/// Arguments of `health`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Where the service listens
    #[arg(long, default_value = "127.0.0.1:8080", env = "QUADRILLE_LISTEN", value_parser = super::socket_address)]
    address: SocketAddr,
}

/// How long the service may take to answer.
const PATIENCE: Duration = Duration::from_secs(3);

pub(super) fn run(arguments: &Arguments) -> Answer {
    match ready(reachable(arguments.address)) {
        Ok(true) => Answer::Yes,
        Ok(false) => {
            eprintln!("the service is not ready");
            Answer::No
        }
        Err(error) => {
            eprintln!("{}: {error}", arguments.address);
            Answer::No
        }
    }
}

/// An address that listens everywhere is asked on this machine.
fn reachable(mut address: SocketAddr) -> SocketAddr {
    match address.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => address.set_ip(Ipv4Addr::LOCALHOST.into()),
        IpAddr::V6(ip) if ip.is_unspecified() => address.set_ip(Ipv6Addr::LOCALHOST.into()),
        _ => {}
    }
    address
}

fn ready(address: SocketAddr) -> std::io::Result<bool> {
    let mut stream = TcpStream::connect_timeout(&address, PATIENCE)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    write!(stream, "GET /readyz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    let mut status = [0; 12];
    stream.read_exact(&mut status)?;
    Ok(status.ends_with(b" 200"))
}
