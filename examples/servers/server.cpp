// A policy server in C++17 with Boost.Beast and msgpack-cxx (Debian: libboost-dev libmsgpack-cxx-dev):
//   g++ -std=c++17 -O2 -DMSGPACK_NO_BOOST server.cpp -o server -pthread && ./server 8000
// Then:  gn0 bench run SUITE --policy remote --policy-option url=ws://127.0.0.1:8000 --out OUT
#include <algorithm>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/websocket.hpp>
#include <cstdint>
#include <cstring>
#include <iostream>
#include <map>
#include <msgpack.hpp>
#include <string>
#include <thread>
#include <vector>

namespace asio = boost::asio;
namespace beast = boost::beast;
using Map = std::map<std::string, msgpack::object>;

// {__ndarray__: true, data: bytes, dtype: "<f4", shape: [72]} on a little-endian machine
std::vector<float> read_floats(const msgpack::object& object) {
  const auto found = object.as<Map>();
  if (found.at("dtype").as<std::string>() != "<f4") throw std::runtime_error("float32 expected");
  const auto& bytes = found.at("data").via.bin;
  std::vector<float> values(bytes.size / sizeof(float));
  std::memcpy(values.data(), bytes.ptr, values.size() * sizeof(float));
  return values;
}

void send(beast::websocket::stream<asio::ip::tcp::socket>& socket, const msgpack::sbuffer& message) {
  socket.binary(true);
  socket.write(asio::buffer(message.data(), message.size()));
}

void serve(asio::ip::tcp::socket connection) try {
  connection.set_option(asio::ip::tcp::no_delay(true));
  beast::websocket::stream<asio::ip::tcp::socket> socket(std::move(connection));
  socket.read_message_max(16 << 20);
  socket.accept();
  msgpack::sbuffer greeting;
  msgpack::packer<msgpack::sbuffer> hello(greeting);
  hello.pack_map(1).pack("gn0").pack_map(4);
  hello.pack("version").pack(1).pack("name").pack("c++").pack("keys").pack("text");
  hello.pack("wants").pack(std::vector<std::string>{"ranges"});
  send(socket, greeting);
  for (int asked = 0;;) {
    beast::flat_buffer frame;
    socket.read(frame);
    const auto handle = msgpack::unpack(static_cast<const char*>(frame.data().data()), frame.size());
    const auto request = handle.get().as<Map>();
    msgpack::sbuffer answer;
    msgpack::packer<msgpack::sbuffer> reply(answer);
    if (request.at("endpoint").as<std::string>() == "reset") {
      asked = 0;
      reply.pack_map(1).pack("status").pack("ok");
    } else {  // your model goes here
      const auto ranges = read_floats(request.at("gn0").as<Map>().at("ranges"));
      const float ahead = std::min({ranges.at(0), ranges.at(1), ranges.back()});
      const int action = ++asked > 60 ? 0 : ahead > 0.8f ? 1 : 2;  // STOP, FORWARD, LEFT
      reply.pack_map(2).pack("action_type").pack("discrete").pack("actions");
      reply.pack(std::vector<int>{action});
    }
    send(socket, answer);
  }
} catch (const std::exception& error) {
  std::cerr << error.what() << std::endl;  // the client is gone, or sent what is no request
}

int main(int count, char** words) {
  const auto port = static_cast<std::uint16_t>(count > 1 ? std::stoi(words[1]) : 8000);
  asio::io_context context;
  asio::ip::tcp::acceptor door(context, {asio::ip::address_v4::loopback(), port});
  std::cout << "ws://127.0.0.1:" << door.local_endpoint().port() << std::endl;
  for (;;) {
    std::thread(serve, door.accept()).detach();
  }
}
